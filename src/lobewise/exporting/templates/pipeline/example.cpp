// Denoises the ${frames} frames of frames.raw with the pipeline ${name}, writes output.raw, and compares every frame
// with expected.raw, which Python made. README.md says how to build the program. Run it in this folder; its exit code is
// 0 if both results agree.
#include <cmath>
#include <cstdio>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "${name}.hpp"

namespace {

const int width = ${width}, height = ${height}, frames = ${frames};

template <typename T> std::vector<T> read(std::ifstream &file, std::size_t count) {
    std::vector<T> values(count);
    if (!file.read(reinterpret_cast<char *>(values.data()), static_cast<std::streamsize>(count * sizeof(T)))) {
        throw std::runtime_error("a file is missing or ends too early");
    }
    return values;
}

double compare(const std::vector<float> &found, const std::vector<float> &expected) {
    double largest = 0.0;
    for (std::size_t k = 0; k < found.size(); k++) {
        double difference = std::fabs(static_cast<double>(found[k]) - expected[k]);
        if (difference > 0.0) {
            difference /= std::fabs(static_cast<double>(expected[k]));
        }
        if (!(difference <= largest)) {
            largest = std::isnan(difference) ? HUGE_VAL : difference;
        }
    }
    return largest;
}

} // namespace

int main() {
    try {
        std::ifstream input("frames.raw", std::ios::binary), reference("expected.raw", std::ios::binary);
        std::ofstream output("output.raw", std::ios::binary);
        ${name}::Pipeline pipeline(width, height);
        ${name}::Settings settings = pipeline.settings();
        settings.samples_per_pixel = ${spp};
        pipeline.set(settings);
        std::printf("%.1f bytes for each pixel\n", static_cast<double>(pipeline.bytes()) / (width * height));
        double largest = 0.0;
        for (int number = 0; number < frames; number++) {
            const std::vector<double> view = read<double>(input, 15);
            ${name}::Camera camera = {{view[0], view[1], view[2]}, {view[3], view[4], view[5]}, {view[6], view[7], view[8]},
                                      view[9], view[10], {view[11], view[12]}};
            ${name}::Frame frame = {};
${places}${reading}
            std::vector<float> image(3 * width * height);
            frame.image = image.data();
            pipeline.run(camera, frame);
            output.write(reinterpret_cast<const char *>(image.data()), static_cast<std::streamsize>(image.size() * sizeof(float)));
            const double difference = compare(image, read<float>(reference, image.size()));
            std::printf("frame %d: largest relative difference %.2e\n", number, difference);
            largest = difference <= largest ? largest : difference;
        }
        double seconds = 0.0;
        for (int stage = 0; stage < ${name}_stages; stage++) {
            const char *name = ${name}_get_stage(pipeline.get(), stage, &seconds);
            std::printf("%8.3f ms of processor time: %s\n", 1e3 * seconds, name);
        }
        return largest <= ${bound} && output ? 0 : 1;
    } catch (const std::exception &problem) {
        std::fprintf(stderr, "%s\n", problem.what());
        return 1;
    }
}
