// Light is divided by an albedo of at least this. Where no channel is above it, a pixel does not show its light.
const float LOBEWISE_ALBEDO_FLOOR = $ALBEDO_FLOOR;
// The smallest squared length of a normal: shorter ones mean that the pixel shows no surface.
const float LOBEWISE_MIN_SQUARED_NORMAL = $MIN_SQUARED_NORMAL;
// log2(e)
const float LOBEWISE_LOG2_E = 1.442695041;
// Shares of red, green and blue in the luminance.
const vec3 LOBEWISE_LUMINANCE = $LUMINANCE;
// Exponent that all exponents of the overlap of two GGX lobes are multiples of.
const float LOBEWISE_GGX_UNIT = $GGX_UNIT;
// Taps of the form "atrous": log2 of the B-spline weights at the distances 0, 1 and 2.
const vec3 LOBEWISE_PROFILE = $PROFILE;
// Radius of the window in which samples and history are compared, samples.
const int LOBEWISE_TRUST_RADIUS = $TRUST_RADIUS;
// Difference of samples and history, in standard errors: from the first on the trust is 0, up to the second it is 1.
const float LOBEWISE_NO_TRUST_ERRORS = $NO_TRUST_ERRORS;
const float LOBEWISE_FULL_TRUST_ERRORS = $FULL_TRUST_ERRORS;
// Relative difference of samples and history that does not count as a change.
const float LOBEWISE_IGNORED_DIFFERENCE = $IGNORED_DIFFERENCE;
// Smallest weight sum above 0.
const float LOBEWISE_MIN_WEIGHT = $MIN_WEIGHT;
// A place this near to a pixel's centre is moved to the centre, pixels: rounding must not blur.
const float LOBEWISE_SNAP = $SNAP_PIXELS;
// Ratio of the squared steps to two neighbours above which the longer step crosses an object's edge.
const float LOBEWISE_MIN_EDGE_RATIO = $MIN_EDGE_RATIO;
// Distance of the virtual image of what is not hit, over the distance from the camera.
const float LOBEWISE_MISS_DISTANCE = $MISS_DISTANCE;
// Standard deviation of the logarithm of a mirror's hit distance between two frames, and more per radian of a lobe.
const float LOBEWISE_HIT_TOLERANCE = $HIT_TOLERANCE;
const float LOBEWISE_HIT_TOLERANCE_PER_LOBE = $HIT_TOLERANCE_PER_LOBE;
// Frames in a trusted history from which a pixel has the narrow kernel.
const float LOBEWISE_MIN_KNOWN_FRAMES = $MIN_KNOWN_FRAMES;

// Whether a number is NaN, infinite or negative. Bits tell it even where arithmetic ignores NaN.
bool lobewise_is_bad(float value) {
    let uint bits = bits_of(value);
    return bits >= 0x7f800000u && bits != 0x80000000u;
}

// Whether no channel of a colour is NaN, infinite or negative.
bool lobewise_is_good(vec3 color) {
    return !(lobewise_is_bad(color.x) || lobewise_is_bad(color.y) || lobewise_is_bad(color.z));
}

// Whether a number is neither infinite nor NaN.
bool lobewise_is_finite(float value) {
    return (bits_of(value) & 0x7f800000u) != 0x7f800000u;
}

// Whether a pixel lies inside the image.
bool lobewise_is_inside(ivec2 pixel) {
    return pixel.x >= 0 && pixel.y >= 0 && pixel.x < constants.width && pixel.y < constants.height;
}

// The larger principal variance of a covariance, in w, and in xyz a vector t along its direction. The squared length of
// t is the difference of both variances; its sign means nothing.
vec4 lobewise_split(LobewiseCovariance lobe) {
    let vec3 z = lobe.axis;
    let float mean = 0.5 * dot(lobe.diagonal, vec3(1.0, 1.0, 1.0));
    let vec3 crossed = vec3(z.x * z.y, z.x * z.z, z.y * z.z);
    let vec3 across = vec3(1.0, 1.0, 1.0) - z * z;
    // The covariance minus its mean across the axis: its norm gives the difference without cancellation.
    let vec3 rest = lobe.diagonal - mean * across;
    let vec3 beside = lobe.beside + mean * crossed;
    let float gap = sqrt(2.0 * (dot(rest, rest) + 2.0 * dot(beside, beside)));
    // t t^T, of which t is the longest column over the root of its diagonal.
    let vec3 outer = rest + 0.5 * gap * across;
    let vec3 outside = beside - 0.5 * gap * crossed;
    var vec3 column = vec3(outside.y, outside.z, outer.z);
    if (outer.x >= outer.y && outer.x >= outer.z) {
        column = vec3(outer.x, outside.x, outside.y);
    } else if (outer.y >= outer.z) {
        column = vec3(outside.x, outer.y, outside.z);
    }
    let float longest = max(max(max(outer.x, outer.y), outer.z), 0.3 * gap);
    return vec4(column / sqrt(max(longest, 1.0e-30)), mean + 0.5 * gap);
}

// Column and row, pixel centres at whole numbers, where the camera of the frame before saw a step from it, and how far
// ahead the step leads (z; not above 0 behind the camera).
vec3 lobewise_project(vec3 path) {
    let float ahead = dot(path, constants.before_forward);
    let float right = dot(path, constants.before_right) / ahead;
    let float up = dot(path, constants.before_up) / ahead;
    let vec2 half_size = 0.5 * vec2(float(constants.width), float(constants.height));
    return vec3(vec2(1.0 + right, 1.0 - up) * half_size - vec2(0.5, 0.5), ahead);
}

// How far a surface moved by itself since the frame before, pixels. moved is its motion on the screen; the motion of
// the camera is subtracted. A point that lay behind the earlier camera moved by twice the image.
float lobewise_find_own_motion(ivec2 pixel, vec3 position, vec2 moved) {
    let vec3 seen = lobewise_project(position - constants.before);
    var vec2 still = 2.0 * vec2(float(constants.width), float(constants.height));
    if (seen.z > 0.0) {
        still = seen.xy - vec2(float(pixel.x), float(pixel.y));
    }
    let float way = length(moved - still);
    if (lobewise_is_finite(way)) {
        return way;
    }
    return 0.0;
}

// From a pixel to a neighbour: the slope of the normal along the step, 1/world unit (x), and the squared step (y).
vec2 lobewise_find_slope(ivec2 pixel, ivec2 neighbour) {
    let vec3 way = load(place, neighbour).xyz - load(place, pixel).xyz;
    let vec3 turn = load(surface, neighbour).xyz - load(surface, pixel).xyz;
    let float square = dot(way, way);
    let float slope = dot(turn, way) / max(square, 1.0e-20);
    if (lobewise_is_finite(slope)) {
        return vec2(slope, square);
    }
    return vec2(0.0, 1.0e37);
}

// The slope on the much nearer side, or else the flatter one: neither edges of objects nor creases count.
float lobewise_choose_side(vec2 first, vec2 second) {
    if (first.y > LOBEWISE_MIN_EDGE_RATIO * second.y) {
        return second.x;
    }
    if (second.y > LOBEWISE_MIN_EDGE_RATIO * first.y || abs(first.x) < abs(second.x)) {
        return first.x;
    }
    return second.x;
}

// Mean curvature of the surface at a pixel, 1/world unit, above 0 for convex.
float lobewise_find_curvature(ivec2 pixel) {
    let int left = clamp(pixel.x - 1, 0, max(constants.width - 2, 0));
    let int here = clamp(pixel.x, 0, max(constants.width - 2, 0));
    let int above = clamp(pixel.y - 1, 0, max(constants.height - 2, 0));
    let int middle = clamp(pixel.y, 0, max(constants.height - 2, 0));
    let vec2 before = lobewise_find_slope(ivec2(left, pixel.y), ivec2(min(left + 1, constants.width - 1), pixel.y));
    let vec2 after = lobewise_find_slope(ivec2(here, pixel.y), ivec2(min(here + 1, constants.width - 1), pixel.y));
    let vec2 over = lobewise_find_slope(ivec2(pixel.x, above), ivec2(pixel.x, min(above + 1, constants.height - 1)));
    let vec2 under = lobewise_find_slope(ivec2(pixel.x, middle), ivec2(pixel.x, min(middle + 1, constants.height - 1)));
    return 0.5 * (lobewise_choose_side(before, after) + lobewise_choose_side(over, under));
}

// log2 of the Gaussian of the distance on the screen. offset counts pixels.
float lobewise_compare_screen(vec2 offset, float sigma) {
    return -0.5 * LOBEWISE_LOG2_E * dot(offset, offset) / (sigma * sigma);
}

// log2 of the Gaussian of the distance in the scene, in footprints of a pixel.
float lobewise_compare_places(vec3 position_i, float depth_i, vec3 position_j, float depth_j) {
    let vec3 d = (position_j - position_i) / (constants.position_sigma * constants.pixel_angle);
    return -0.5 * LOBEWISE_LOG2_E * dot(d, d) / (depth_i * depth_j);
}

// log2 of the Gaussian of the distances from each other's tangent planes, in footprints. It recognises a surface.
float lobewise_compare_planes(vec4 point_i, vec3 normal_i, vec4 point_j, vec3 normal_j) {
    let vec3 d = point_j.xyz - point_i.xyz;
    let float above = dot(normal_i, d);
    let float below = dot(normal_j, d);
    let float scale = constants.plane_sigma * constants.plane_sigma * point_i.w * point_j.w;
    return -0.25 * LOBEWISE_LOG2_E * (above * above + below * below) / scale;
}

// log2 of the overlap of two cosine lobes, to the power beta.
float lobewise_compare_cosines(vec3 normal_i, vec3 normal_j, float beta) {
    let vec3 d = normal_j - normal_i;
    let float x = 0.5 * dot(d, d);
    let float quotient = $LAMBERT;
    return -beta * x * quotient;
}

// What a tap adds to the sums of a pixel.
struct LobewiseTap {
    vec4 light; // light and weight
    vec4 more; // squared weight, squared luminance
};

// A sample's radiance over albedo (xyz) and 1 (w). All are 0 if one is bad, or if no channel of the albedo is above least:
// then the sample does not show its light.
vec4 lobewise_divide(vec3 given, vec3 tint, float least) {
    let float brightest = max(max(tint.x, tint.y), tint.z);
    if (lobewise_is_good(given) && lobewise_is_good(tint) && brightest > least) {
        return vec4(given / max(tint, vec3(least, least, least)), 1.0);
    }
    return vec4(0.0, 0.0, 0.0, 0.0);
}

// A tap of noisy radiance.
LobewiseTap lobewise_read_radiance(ivec2 pixel) {
    let vec3 given = load(radiance, pixel).xyz;
    let vec4 light = lobewise_divide(given, load(albedo, pixel).xyz, LOBEWISE_ALBEDO_FLOOR);
    let float luminance = dot(LOBEWISE_LUMINANCE, light.xyz);
    var LobewiseTap tap;
    tap.light = light;
    tap.more = vec4(light.w, luminance * luminance, 0.0, 0.0);
    return tap;
}

// A tap of the undivided sums of the pass before.
LobewiseTap lobewise_read_sums(ivec2 pixel) {
    var LobewiseTap tap;
    tap.light = load(sums_light, pixel);
    tap.more = load(sums_more, pixel);
    return tap;
}

// log2 of the B-spline weight of a tap, -2 to 2.
float lobewise_find_profile(int offset) {
    if (offset == 0) {
        return LOBEWISE_PROFILE.x;
    }
    if (offset == 1 || offset == -1) {
        return LOBEWISE_PROFILE.y;
    }
    return LOBEWISE_PROFILE.z;
}

// A number, or 0 if it is NaN, infinite or negative.
float lobewise_drop_bad(float value) {
    if (lobewise_is_bad(value)) {
        return 0.0;
    }
    return value;
}

// The radiance of a layer: its sums divided by their weight, times its albedo. Where nothing was gathered it is the noisy
// radiance, or black where that is bad.
vec3 lobewise_finish(vec4 sums, vec3 tint, vec3 noisy) {
    if (sums.w > 0.0) {
        return sums.xyz / sums.w * vec3(lobewise_drop_bad(tint.x), lobewise_drop_bad(tint.y), lobewise_drop_bad(tint.z));
    }
    if (lobewise_is_good(noisy)) {
        return noisy;
    }
    return vec3(0.0, 0.0, 0.0);
}

// A place on the screen, moved to a pixel's centre if it is very near.
float lobewise_snap(float place) {
    let float whole = floor(place + 0.5);
    if (abs(place - whole) < LOBEWISE_SNAP) {
        return whole;
    }
    return place;
}

// A sample beside the history of its pixel.
struct LobewiseDifference {
    vec3 step; // light of the sample minus that of the history
    vec3 before; // light of the history
    float known; // 1 if both are known, else 0
};

// Compares a sample with the history of its pixel. A history without own samples of the pixel does not count: it is
// blurred, and samples without noise would reject it.
LobewiseDifference lobewise_compare_sample(ivec2 sampled, ivec2 pixel) {
    let vec3 given = load(radiance, sampled).xyz;
    let vec4 light = lobewise_divide(given, load(albedo, pixel).xyz, LOBEWISE_ALBEDO_FLOOR / constants.own);
    let vec4 past = load(history_light, pixel);
    var LobewiseDifference found;
    found.step = vec3(0.0, 0.0, 0.0);
    found.before = vec3(0.0, 0.0, 0.0);
    found.known = 0.0;
    if (past.w > 0.0) {
        found.before = past.xyz / past.w;
    }
    if (light.w > 0.0 && past.w > 0.5 * constants.own) {
        let vec3 between = light.xyz - found.before;
        if (lobewise_is_good(between * between)) {
            found.step = between;
            found.known = 1.0;
        }
    }
    return found;
}

// The difference of samples and history in standard errors, for one colour. above and below are the means of positive
// and of negative differences, squares is the mean square, count the number of samples.
float lobewise_find_errors(float above, float below, float squares, float before, float count) {
    let float way = abs(above - below);
    let float error = sqrt(max(squares - way * way, 0.0) / (count - 1.0));
    let float allowed = error + LOBEWISE_IGNORED_DIFFERENCE * (before + way);
    if (allowed > 0.0) {
        return way / allowed;
    }
    return 0.0;
}

// Sums over the samples of a pixel.
struct LobewiseSums {
    vec4 light; // weight times light, and weight
    vec3 more; // squared weight, weight times squared luminance, frames
};

// This frame's contribution to a pixel: sums over taps, in which a full match gets the weight unit.
LobewiseSums lobewise_weigh(vec4 light, float squares, float moment, float unit) {
    var LobewiseSums sums;
    sums.light = vec4(0.0, 0.0, 0.0, 0.0);
    sums.more = vec3(0.0, 0.0, 0.0);
    if (light.w * unit > 0.0) {
        let float weight = max(light.w * unit, LOBEWISE_MIN_WEIGHT);
        var float count = 1.0;
        if (squares > 0.0) {
            count = max(light.w * light.w / squares, 1.0);
        }
        sums.light = vec4(light.xyz / light.w * weight, weight);
        sums.more = vec3(weight * weight / count, moment / light.w * weight, 1.0);
    }
    return sums;
}

// The bonus of a pixel's own sample, beyond its weight among the taps. light is the result of lobewise_divide.
LobewiseSums lobewise_weigh_own(vec4 light, float unit) {
    let float weight = (constants.own - 1.0) * unit * light.w;
    let float luminance = dot(LOBEWISE_LUMINANCE, light.xyz);
    var LobewiseSums sums;
    sums.light = vec4(weight * light.xyz, weight);
    sums.more = vec3(weight * (weight + 2.0 * unit), weight * luminance * luminance, 0.0);
    return sums;
}

// What a pixel finds in the frame before.
struct LobewiseHistory {
    vec4 light; // sums of weight times light, and of weights
    vec4 more; // squared weight, squared luminance, frames; agreement, 0 to 1
};

// The history at a place in the frame before: of the four pixels around it, by bilinear weights times similarity.
// is_surface tells whether surfaces are compared beside lobes.
LobewiseHistory lobewise_gather(ivec2 pixel, vec2 given, bool is_surface) {
    var LobewiseHistory found;
    found.light = vec4(0.0, 0.0, 0.0, 0.0);
    found.more = vec4(0.0, 0.0, 0.0, 0.0);
    let bool is_right = given.x > -1.0 && given.x < float(constants.width);
    let bool is_below = given.y > -1.0 && given.y < float(constants.height);
    if (!(lobewise_is_finite(given.x + given.y) && is_right && is_below)) {
        return found;
    }
    let vec2 spot = vec2(lobewise_snap(given.x), lobewise_snap(given.y));
    let vec2 corner = floor(spot);
    for (var int k = 0; k < 4; k += 1) {
        let int u = k % 2;
        let int v = k / 2;
        let ivec2 before = ivec2(int(corner.x) + u, int(corner.y) + v);
        if (!lobewise_is_inside(before)) {
            continue;
        }
        let vec4 light = load(past_light, before);
        let vec4 more = load(past_more, before);
        // A history that is not a number would spread by a pixel with every frame.
        let float total = light.x + light.y + light.z + light.w + more.x + more.y + more.z;
        if (!lobewise_was_usable(before) || lobewise_is_bad(total)) {
            continue;
        }
        let float agreement = exp2(lobewise_compare_frames(pixel, before, is_surface));
        let vec2 share = vec2(float(1 - u), float(1 - v)) - (spot - corner);
        let float weight = abs(share.x * share.y) * agreement;
        found.light += weight * light;
        found.more += weight * vec4(agreement * more.x, more.y, more.z, 1.0);
    }
    return found;
}
