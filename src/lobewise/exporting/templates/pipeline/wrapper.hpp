// ${title}: the pipeline of ${name}.h as a C++ class. C++11, needs no library beside ${name}.
#ifndef ${guard}
#define ${guard}

#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "${name}.h"

namespace ${name} {

using Camera = ${name}_camera;
using Frame = ${name}_frame;
using Settings = ${name}_settings;

/// A function of the pipeline refused its input or failed.
class Error : public std::runtime_error {
public:
    Error(${name}_status status, const std::string &message) : std::runtime_error(message), status_(status) {}
    ${name}_status status() const noexcept { return status_; }

private:
    ${name}_status status_;
};

/// Denoises the frames of one view. Owns all memory that it needs; may be moved, not copied.
class Pipeline {
public:
    Pipeline(int width, int height, std::size_t most_bytes = static_cast<std::size_t>(-1)) {
        ${name}_pipeline *made = nullptr;
        const ${name}_status status = ${name}_create_within(width, height, most_bytes, &made);
        if (status != ${name}_ok) {
            throw Error(status, ${name}_explain(status));
        }
        pipeline_.reset(made);
    }

    Settings settings() const {
        Settings found;
        ${name}_get_settings(pipeline_.get(), &found);
        return found;
    }

    void set(const Settings &settings) { check(${name}_set_settings(pipeline_.get(), &settings)); }

    void run(const Camera &camera, const Frame &frame) { check(${name}_run(pipeline_.get(), &camera, &frame)); }

    /// Calls a function before each part of a frame, with the parts that are done and all parts. If it returns false,
    /// the frame is cancelled: run throws an Error of the status ${name}_cancelled. The function must not throw.
    void on_progress(std::function<bool(int, int)> progress) {
        progress_.reset(new std::function<bool(int, int)>(std::move(progress)));
        ${name}_set_progress(pipeline_.get(), *progress_ ? &tell : nullptr, progress_.get());
    }

    void reset() noexcept { ${name}_reset(pipeline_.get()); }

    std::size_t bytes() const noexcept { return ${name}_count_bytes(pipeline_.get()); }

    ${name}_pipeline *get() const noexcept { return pipeline_.get(); }

private:
    struct Destroy {
        void operator()(${name}_pipeline *pipeline) const noexcept { ${name}_destroy(pipeline); }
    };

    void check(${name}_status status) const {
        if (status != ${name}_ok) {
            throw Error(status, ${name}_get_message(pipeline_.get()));
        }
    }

    static int tell(void *user, int done, int parts) {
        return !(*static_cast<std::function<bool(int, int)> *>(user))(done, parts);
    }

    std::unique_ptr<${name}_pipeline, Destroy> pipeline_;
    std::unique_ptr<std::function<bool(int, int)>> progress_;
};

} // namespace ${name}

#endif
