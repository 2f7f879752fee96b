// Weights of a cross-bilateral filter that compares the reflections of two pixels, so that edges of gloss stay sharp.
//
// A filter sums over the neighbours j of a pixel i
//     out_i = sum_j w(i, j) radiance_j / sum_j w(i, j)
//     w(i, j) = screen weight * position weight * lobe weight
// It divides the radiance by the albedo of the lobe before, and multiplies the result by the albedo after. Every weight
// is in [0, 1], symmetric in i and j, and 1 for equal pixels. Make the lobe of each pixel once, in a pass of its own,
// and store it.
//
// Directions are unit vectors in world space: normal and view point away from the surface, view towards the camera.
// alpha is the microfacet roughness of GGX, the square of what most engines call roughness; 0 is a mirror. tau is a
// band-limit in radians, the angle of a pixel or more: its square is added to the variance of every lobe, so that the
// lobe of a mirror is finite. 1 / tau^2, the largest sharpness, may be 1e7. Lobe weights are raised to the power
// beta: 2 for 1 sample per pixel, 4 for 4 samples, 10 for 64.
//
// Sources: Tokuyoshi 2015, "Specular Lobe-Aware Filtering and Upsampling for Interactive Indirect Illumination"
// (weights as normalised product integrals); Wang et al. 2009, "All-Frequency Rendering of Dynamic, Spatially-Varying
// Reflectance" (spherical Gaussians of BRDFs and their warp); Iwasaki et al. 2012 (product integral of sharp lobes);
// Xu et al. 2013, "Anisotropic Spherical Gaussians"; the covariance lobes and all fitted constants: lobewise.

// n.v below which a normal is bent towards the viewer.
const float LOBEWISE_MIN_COSINE = $MIN_COSINE;
// Floor of n.v in the warp of a spherical Gaussian: below it the lobe would be sharper than any lobe of a surface.
const float LOBEWISE_MIN_WARP_COSINE = $MIN_WARP_COSINE;
// Floor of v.m in the Jacobian of the reflection: below it the lobe would have no width across the plane of incidence.
const float LOBEWISE_MIN_VIEW_COSINE = $MIN_VIEW_COSINE;
// Inverse variance added to rough GGX lobes, so that none is wider than the hemisphere (fitted to quadrature).
const float LOBEWISE_GGX_LIMIT = $GGX_LIMIT;
// The share of the dominant normal's turn from n to v: for a mirror, and more per alpha.
const float LOBEWISE_AXIS_TURN = $AXIS_TURN;
const float LOBEWISE_AXIS_TURN_PER_ALPHA = $AXIS_TURN_PER_ALPHA;
// Exponents b and weights w of (1 + q)^-2 ~ sum w exp(-b q), least squares over the plane: GGX as three Gaussians.
const vec3 LOBEWISE_MIXTURE_EXPONENTS = $MIXTURE_EXPONENTS;
const vec3 LOBEWISE_MIXTURE_WEIGHTS = $MIXTURE_WEIGHTS;
// Floor of the sharpness of each of the three Gaussians before the band-limit: none is wider than the hemisphere.
const float LOBEWISE_MIN_SHARPNESS = $MIN_SHARPNESS;
const float LOBEWISE_PI = 3.14159265;

// A spherical Gaussian exp(sharpness (w.axis - 1)).
struct LobewiseSg {
    vec3 axis;
    float sharpness; // 1/rad^2
};

// A sum of up to four spherical Gaussians about one axis. A Gaussian that is absent has the amplitude 0.
struct LobewiseMixture {
    vec3 axis;
    vec4 sharpness; // 1/rad^2, above 0
    vec4 amplitude;
};

// A lobe as a covariance across its axis, a symmetric matrix S with S axis = 0.
struct LobewiseCovariance {
    vec3 axis;
    vec3 diagonal; // S.xx, S.yy, S.zz, rad^2
    vec3 beside; // S.xy, S.xz, S.yz, rad^2
    float determinant; // product of the two principal variances, rad^4, above 0
};

// Gaussian of the distance on the screen, sigma in pixels.
float lobewise_screen_weight(vec2 pixel_i, vec2 pixel_j, float sigma) {
    let vec2 d = pixel_j - pixel_i;
    return exp(-0.5 * dot(d, d) / (sigma * sigma));
}

// Gaussian of the distance in the scene. sigma counts footprints. A pixel has the footprint depth * pixel_angle; depth
// is the distance from the camera. The geometric mean of both footprints keeps the weight symmetric.
float lobewise_position_weight(vec3 position_i, float depth_i, vec3 position_j, float depth_j, float pixel_angle, float sigma) {
    let vec3 d = (position_j - position_i) / (sigma * pixel_angle);
    return exp(-0.5 * dot(d, d) / (depth_i * depth_j));
}

// exp(-exponent (1 - n_i.n_j)), the weight of usual filters. |a - b|^2 / 2 is 1 - a.b without loss of digits.
float lobewise_normal_weight(vec3 normal_i, vec3 normal_j, float exponent) {
    let vec3 d = normal_j - normal_i;
    return exp(-0.5 * exponent * dot(d, d));
}

// Overlap of two cosine lobes to the power beta, for diffuse light: ((pi - d) cos d + sin d) / pi at the angle d.
// Its logarithm to base 2 is replaced by a polynomial in 1 - cos d; the error is below 0.004.
float lobewise_diffuse_weight(vec3 normal_i, vec3 normal_j, float beta) {
    let vec3 d = normal_j - normal_i;
    let float x = 0.5 * dot(d, d);
    let float quotient = $LAMBERT;
    return exp2(-beta * x * quotient);
}

// Bends a normal that faces away from the viewer towards it. Interpolated and mapped normals need this.
vec3 lobewise_face_viewer(vec3 normal, vec3 view) {
    return normalize(normal + max(LOBEWISE_MIN_COSINE - dot(normal, view), 0.0) * view);
}

// The single lobe of a GGX reflection: normals of sharpness 2 / alpha^2, warped by 1 / (4 n.v) (Wang et al. 2009).
LobewiseSg lobewise_make_sg(vec3 normal, vec3 view, float alpha, float tau) {
    let float cosine = dot(normal, view);
    var LobewiseSg lobe;
    lobe.axis = 2.0 * cosine * normal - view;
    lobe.sharpness = 1.0 / (2.0 * max(cosine, LOBEWISE_MIN_WARP_COSINE) * alpha * alpha + tau * tau);
    return lobe;
}

// Tokuyoshi 2015, single lobe: (2 sqrt(a b) / (a + b))^beta exp(-beta a b / (a + b) (1 - axis_i.axis_j)).
float lobewise_sg_weight(LobewiseSg i, LobewiseSg j, float beta) {
    let vec3 d = j.axis - i.axis;
    let float total = i.sharpness + j.sharpness;
    let float ratio = min(2.0 * sqrt(i.sharpness) * sqrt(j.sharpness) / total, 1.0);
    return exp(beta * (log(ratio) - 0.5 * i.sharpness * (j.sharpness / total) * dot(d, d)));
}

// A GGX reflection as three Gaussians, which keep its tail. The sum of their integrals does not depend on alpha.
LobewiseMixture lobewise_make_mixture(vec3 normal, vec3 view, float alpha, float tau) {
    let float cosine = dot(normal, view);
    let float square = alpha * alpha;
    let float area = 2.0 * max(abs(cosine), LOBEWISE_MIN_WARP_COSINE) * square;
    let float least = LOBEWISE_MIN_SHARPNESS * area;
    let vec3 steepness = max((1.0 - square) * LOBEWISE_MIXTURE_EXPONENTS, vec3(least, least, least));
    let vec3 sharpness = steepness / (area + tau * tau * steepness);
    // Share of each lobe that lies on the sphere. Below an area of 1e-12 the lobe is a mirror's, and lies on it whole.
    let vec3 decay = exp(-2.0 * steepness / max(area, 1.0e-12));
    let vec3 share = LOBEWISE_MIXTURE_WEIGHTS * (vec3(1.0, 1.0, 1.0) - decay) / steepness;
    let vec3 sphere = 2.0 * LOBEWISE_PI * (vec3(1.0, 1.0, 1.0) - exp(-2.0 * sharpness)) / sharpness;
    let float total = dot(share, vec3(1.0, 1.0, 1.0));
    let float reached = dot(LOBEWISE_MIXTURE_WEIGHTS / LOBEWISE_MIXTURE_EXPONENTS, vec3(1.0, 1.0, 1.0));
    var LobewiseMixture lobe;
    lobe.axis = 2.0 * cosine * normal - view;
    lobe.sharpness = vec4(sharpness, 1.0);
    lobe.amplitude = vec4(share / sphere * (reached / total), 0.0);
    return lobe;
}

// Product integral of a Gaussian of unit amplitude with a mixture, Iwasaki et al. 2012: 2 pi / (a + b)
// exp(-a b / (a + b) (1 - c)); x is 1 - c.
float lobewise_mixture_row(float sharpness, LobewiseMixture j, float x) {
    let vec4 total = j.sharpness + sharpness;
    let vec4 terms = exp(-x * sharpness * (j.sharpness / total)) / total;
    return 2.0 * LOBEWISE_PI * dot(j.amplitude, terms);
}

// Product integral of two mixtures.
float lobewise_mixture_inner(LobewiseMixture i, LobewiseMixture j) {
    let vec3 d = j.axis - i.axis;
    let float x = 0.5 * dot(d, d);
    let float first = i.amplitude.x * lobewise_mixture_row(i.sharpness.x, j, x);
    let float second = i.amplitude.y * lobewise_mixture_row(i.sharpness.y, j, x);
    let float third = i.amplitude.z * lobewise_mixture_row(i.sharpness.z, j, x);
    let float fourth = i.amplitude.w * lobewise_mixture_row(i.sharpness.w, j, x);
    return first + second + third + fourth;
}

// The product integral divided by both norms, to the power beta. To save time, divide the amplitudes of each pixel by
// its norm before you store them: then the weight is pow(min(lobewise_mixture_inner(i, j), 1.0), beta).
float lobewise_mixture_weight(LobewiseMixture i, LobewiseMixture j, float beta) {
    let float norms = sqrt(lobewise_mixture_inner(i, i)) * sqrt(lobewise_mixture_inner(j, j));
    return exp(beta * log(clamp(lobewise_mixture_inner(i, j) / norms, 1.0e-30, 1.0)));
}

// Adds weight a a^T to a covariance.
LobewiseCovariance lobewise_add_outer(LobewiseCovariance lobe, float weight, vec3 a) {
    var LobewiseCovariance result = lobe;
    result.diagonal = lobe.diagonal + weight * a * a;
    result.beside = lobe.beside + weight * vec3(a.x * a.y, a.x * a.z, a.y * a.z);
    return result;
}

// An isotropic GGX reflection; the variance noise is added. The view is reflected about the dominant visible normal
// m = normalize(a v + b n), not about n. The principal variances A / (1 + limit A) / 2 follow from the Jacobian of the
// reflection at m and the roughness alpha^2 / (1 - alpha^2) of a projected GGX (Tokuyoshi and Kaplanyan 2021).
LobewiseCovariance lobewise_make_isotropic(vec3 normal, vec3 view, float alpha, float noise) {
    let float cosine = dot(normal, view);
    let float square = alpha * alpha;
    let float deficit = 1.0 - square;
    let float a = min(LOBEWISE_AXIS_TURN + LOBEWISE_AXIS_TURN_PER_ALPHA * alpha, 1.0) * square;
    let float b = sqrt(a + (1.0 - a) * cosine * cosine) + (1.0 - a) * cosine;
    let float inverse_square = 1.0 / (a * a + b * b + 2.0 * a * b * cosine);
    let float inverse = sqrt(inverse_square);
    let float view_cosine = (a + b * cosine) * inverse;
    let float normal_cosine = (a * cosine + b) * inverse;
    let float twice = 2.0 * view_cosine * inverse;
    let float floored = max(view_cosine, LOBEWISE_MIN_VIEW_COSINE);
    let float across_part = 4.0 * square * floored * floored;
    let float along_part = 4.0 * square * normal_cosine;
    let float across_scale = normal_cosine * deficit + LOBEWISE_GGX_LIMIT * across_part;
    let float along_scale = deficit + LOBEWISE_GGX_LIMIT * along_part;
    let float across = 0.5 * across_part / across_scale + noise;
    let float along = 0.5 * along_part / along_scale + noise;
    // (across - along) / |v x n|^2. The outer product of v x n restores the factor, without 0/0 where n = v.
    let float lifted = (floored * floored - view_cosine * view_cosine) / max(1.0 - cosine * cosine, 0.5);
    let float change = (a * a - b * b) * inverse_square + lifted;
    let float excess = 2.0 * square * deficit * change / (across_scale * along_scale);
    var LobewiseCovariance lobe;
    lobe.axis = (twice * a - 1.0) * view + twice * b * normal;
    lobe.diagonal = along * (vec3(1.0, 1.0, 1.0) - lobe.axis * lobe.axis);
    lobe.beside = -along * vec3(lobe.axis.x * lobe.axis.y, lobe.axis.x * lobe.axis.z, lobe.axis.y * lobe.axis.z);
    lobe.determinant = across * along;
    return lobewise_add_outer(lobe, excess, cross(view, normal));
}

// The change of the reflected direction when the normal moves along a tangent: the image of the tangent under the
// Jacobian at m. component and along are tangent.m and tangent.view. The floor of v.m widens only the part across the
// plane of incidence.
vec3 lobewise_reflect_step(vec3 tangent, float component, float along, vec3 m, vec3 view, float view_cosine) {
    let float floored = max(view_cosine, LOBEWISE_MIN_VIEW_COSINE);
    let float lift = floored - view_cosine;
    let float on_view = (along - component * view_cosine) / max(1.0 - view_cosine * view_cosine, 0.5);
    let float on_m = 2.0 * (along - 2.0 * component * view_cosine) - 2.0 * lift * (component - on_view * view_cosine);
    return on_m * m + 2.0 * floored * tangent - 2.0 * lift * on_view * view;
}

// As lobewise_make_isotropic, for two roughnesses. tangent is a unit vector perpendicular to the normal.
LobewiseCovariance lobewise_make_anisotropic(vec3 normal, vec3 tangent, vec3 view, vec2 alpha, float noise) {
    let vec3 bitangent = cross(normal, tangent);
    let vec2 square = alpha * alpha;
    let vec2 deficit = vec2(1.0, 1.0) - square;
    let float cosine = dot(normal, view);
    let float cosine_u = dot(tangent, view);
    let float cosine_v = dot(bitangent, view);
    let float scale = min(LOBEWISE_AXIS_TURN + LOBEWISE_AXIS_TURN_PER_ALPHA * sqrt(alpha.x * alpha.y), 1.0);
    let float u = scale * square.x * cosine_u;
    let float v = scale * square.y * cosine_v;
    let float n = sqrt(u * cosine_u + v * cosine_v + cosine * cosine) + cosine;
    let float inverse = 1.0 / sqrt(u * u + v * v + n * n);
    let vec3 m = inverse * (u * tangent + v * bitangent + n * normal);
    let float view_cosine = inverse * (u * cosine_u + v * cosine_v + n * cosine);
    let float floored = max(view_cosine, LOBEWISE_MIN_VIEW_COSINE);
    let vec3 image_u = lobewise_reflect_step(tangent, inverse * u, cosine_u, m, view, view_cosine);
    let vec3 image_v = lobewise_reflect_step(bitangent, inverse * v, cosine_v, m, view, view_cosine);
    let float weight_u = square.x * deficit.y / (inverse * n);
    let float weight_v = square.y * deficit.x / (inverse * n);
    let float trace = weight_u * dot(image_u, image_u) + weight_v * dot(image_v, image_v);
    let float area = 16.0 * floored * floored * square.x * square.y;
    // (A^-1 + c I)^-1 = (A g + c D I) / (g + c tr(A g) + c^2 D). A g is the sum of both steps' outer products, D is the
    // determinant of A g divided by g.
    let float whole = deficit.x * deficit.y + LOBEWISE_GGX_LIMIT * (trace + LOBEWISE_GGX_LIMIT * area);
    let float half_inverse = 0.5 / whole;
    let float isotropic = half_inverse * LOBEWISE_GGX_LIMIT * area + noise;
    let float spread = half_inverse * (trace + 2.0 * LOBEWISE_GGX_LIMIT * area);
    var LobewiseCovariance lobe;
    lobe.axis = 2.0 * view_cosine * m - view;
    lobe.diagonal = isotropic * (vec3(1.0, 1.0, 1.0) - lobe.axis * lobe.axis);
    lobe.beside = -isotropic * vec3(lobe.axis.x * lobe.axis.y, lobe.axis.x * lobe.axis.z, lobe.axis.y * lobe.axis.z);
    lobe.determinant = 0.25 * area / whole + noise * (spread + noise);
    lobe = lobewise_add_outer(lobe, half_inverse * weight_u, image_u);
    return lobewise_add_outer(lobe, half_inverse * weight_v, image_v);
}

// The lobe for lobewise_ggx_weight.
LobewiseCovariance lobewise_make_ggx(vec3 normal, vec3 view, float alpha, float tau) {
    return lobewise_make_isotropic(normal, view, alpha, tau * tau);
}

// The lobes of a brushed surface: alpha.x is the roughness along the tangent, alpha.y the roughness across it.
LobewiseCovariance lobewise_make_anisotropic_ggx(vec3 normal, vec3 tangent, vec3 view, vec2 alpha, float tau) {
    return lobewise_make_anisotropic(normal, tangent, view, alpha, tau * tau);
}

// Subtracts the variance value from a covariance, in every direction across its axis.
LobewiseCovariance lobewise_subtract_round(LobewiseCovariance lobe, float value) {
    let vec3 z = lobe.axis;
    var LobewiseCovariance rest = lobe;
    rest.diagonal = lobe.diagonal - value * (vec3(1.0, 1.0, 1.0) - z * z);
    rest.beside = lobe.beside + value * vec3(z.x * z.y, z.x * z.z, z.y * z.z);
    return rest;
}

// The eigenvalues a >= b of a covariance, computed without cancellation from its deviation from the mean variance.
vec2 lobewise_eigenvalues(LobewiseCovariance lobe) {
    let float half_trace = 0.5 * dot(lobe.diagonal, vec3(1.0, 1.0, 1.0));
    let LobewiseCovariance rest = lobewise_subtract_round(lobe, half_trace);
    let float half_gap = sqrt(0.5 * (dot(rest.diagonal, rest.diagonal) + 2.0 * dot(rest.beside, rest.beside)));
    let float large = half_trace + half_gap;
    return vec2(large, lobe.determinant / large);
}

// Q and P of lobewise_compare, for GGX. P is computed as if both axes were equal. R gets the variance a along the axis,
// so that lobes that face away from each other are unlike: R = a I - L, where L = S - b P has rank 1.
vec2 lobewise_compare_in_plane(LobewiseCovariance i, LobewiseCovariance j) {
    let vec2 values_i = lobewise_eigenvalues(i);
    let vec2 values_j = lobewise_eigenvalues(j);
    let LobewiseCovariance rest_i = lobewise_subtract_round(i, values_i.y);
    let LobewiseCovariance rest_j = lobewise_subtract_round(j, values_j.y);
    let vec3 d = j.axis - i.axis;
    let vec3 crossed = vec3(d.x * d.y, d.x * d.z, d.y * d.z);
    let vec3 beside = rest_i.beside + rest_j.beside;
    let float longer = dot(rest_i.diagonal + rest_j.diagonal, d * d) + 2.0 * dot(beside, crossed);
    let float quadratic = (values_i.x + values_j.x) * dot(d, d) - longer;
    let float inner = dot(rest_i.diagonal, rest_j.diagonal) + 2.0 * dot(rest_i.beside, rest_j.beside);
    let float second = (values_i.x + values_j.y) * (values_j.x + values_i.y) - inner;
    let float roots = sqrt(i.determinant) + sqrt(j.determinant);
    return vec2(max(quadratic, 0.0), max(second, roots * roots));
}

// Overlap of two GGX lobes to the power beta. With s = 2 sqrt(det) and q = Q / P it is
// (s_i s_j / P)^0.45 (2 sqrt(s_i s_j) / (s_i + s_j))^-0.3 (1 + q / 4)^-2.4. Unequal sizes count with the exponent 0.6,
// unequal shapes with 0.9. The last factor is the autocorrelation of (1 + r^2)^-2 in a plane.
float lobewise_ggx_weight(LobewiseCovariance i, LobewiseCovariance j, float beta) {
    let vec2 compared = lobewise_compare_in_plane(i, j);
    let float root_i = sqrt(i.determinant);
    let float root_j = sqrt(j.determinant);
    let float product = sqrt(root_i) * sqrt(root_j);
    let float sizes = min(2.0 * product / (root_i + root_j), 1.0);
    let float both = min(2.0 * product / sqrt(compared.y), sizes);
    let float exponent = 0.9 * log(both) - 0.3 * log(sizes) - 2.4 * log(1.0 + 0.25 * compared.x / compared.y);
    return exp(beta * exponent);
}
