// The plots of how_it_works.html: lobes in the plane of incidence, and the similarity of two lobes.
"use strict";

const lobes = {
  /** Sharpness of the spherical Gaussian of a GGX reflection (Wang et al. 2009): 1 / (2 alpha^2 n.v). */
  findSharpness: (alpha, cosine) => 1 / (2 * alpha * alpha * Math.max(cosine, 0.1)),
  /** Spherical Gaussian at an angle from its axis. */
  evaluateGaussian: (sharpness, angle) => Math.exp(sharpness * (Math.cos(angle) - 1)),
  /** GGX reflection times cosine in the plane of incidence, angles from the normal (Walter et al. 2007). */
  evaluateGgx(alpha, view, light) {
    const half = (light - view) / 2; // The view lies at -view, the light at +light.
    const c = Math.cos(half);
    const d = (c * alpha) ** 2 + Math.sin(half) ** 2;
    const lambda = (angle) => (Math.sqrt(1 + (alpha * Math.tan(angle)) ** 2) - 1) / 2;
    return (alpha * alpha) / (Math.PI * d * d) / (1 + lambda(view) + lambda(light)) / (4 * Math.cos(view));
  },
  /** Similarity of two spherical Gaussians (Tokuyoshi 2015). */
  findSimilarity(one, two, angle) {
    const sum = one + two;
    return (2 * Math.sqrt(one * two)) / sum * Math.exp((-one * two * (1 - Math.cos(angle))) / sum);
  },
  /** The default exponent of the similarity: 2.5 spp^(1/3), in [1, 64]. */
  chooseExponent: (spp) => Math.min(Math.max(2.5 * Math.cbrt(spp), 1), 64),
};

const degrees = Math.PI / 180;
const size = { width: 640, height: 330, x: 320, y: 300, radius: 270 };

/** The outline of a lobe as an SVG path: radius by angle from the normal. */
function drawLobe(radiusAt) {
  const points = [`M${size.x} ${size.y}`];
  for (let k = -90; k <= 90; k += 0.5) {
    const r = size.radius * Math.max(radiusAt(k * degrees), 0);
    points.push(`L${(size.x + r * Math.sin(k * degrees)).toFixed(1)} ${(size.y - r * Math.cos(k * degrees)).toFixed(1)}`);
  }
  return `<path d="${points.join("")}Z"/>`;
}

function drawArrow(angle, text, length = 0.96) {
  const x = size.x + length * size.radius * Math.sin(angle), y = size.y - length * size.radius * Math.cos(angle);
  return `<line x1="${size.x}" y1="${size.y}" x2="${x}" y2="${y}"/><text x="${x}" y="${y - 6}" text-anchor="middle">${text}</text>`;
}

const drawings = {
  lobe(values) {
    const view = values.view * degrees, alpha = values.alpha;
    let most = 0;
    for (let k = -89; k < 90; k += 0.25) most = Math.max(most, lobes.evaluateGgx(alpha, view, k * degrees));
    const sharpness = lobes.findSharpness(alpha, Math.cos(view));
    const ggx = drawLobe((angle) => (Math.abs(angle) < 89.5 * degrees ? lobes.evaluateGgx(alpha, view, angle) / most : 0));
    const gaussian = drawLobe((angle) => lobes.evaluateGaussian(sharpness, angle - view));
    return {
      svg: `<g class="first">${ggx}</g><g class="second">${gaussian}</g><g class="arrows">${drawArrow(-view, "to the eye")}${drawArrow(0, "normal")}</g>`,
      text: `The spherical Gaussian has the sharpness ${sharpness.toPrecision(3)}.`,
    };
  },
  pair(values) {
    const between = values.between * degrees;
    // Both are seen along the first normal; a turned normal turns the reflection twice as far.
    const one = lobes.findSharpness(values.first, 1), two = lobes.findSharpness(values.second, Math.cos(between));
    const similarity = lobes.findSimilarity(one, two, 2 * between);
    const exponent = lobes.chooseExponent(values.spp);
    const draw = (sharpness, axis) => drawLobe((angle) => lobes.evaluateGaussian(sharpness, angle - axis));
    const percent = (x) => `${(100 * x).toPrecision(2)} %`;
    return {
      svg: `<g class="first">${draw(one, 0)}</g><g class="second">${draw(two, 2 * between)}</g>`,
      text: `Similarity S = ${similarity.toFixed(3)}. Weight S^β = ${percent(similarity ** exponent)}, with β = ${exponent.toFixed(1)}. ` +
        `A filter that compares normals, with the exponent 64, says ${percent(Math.cos(between) ** 64)}.`,
    };
  },
};

document.addEventListener("DOMContentLoaded", () => {
  for (const box of document.querySelectorAll(".lobe-plot")) {
    const shown = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    shown.setAttribute("viewBox", `0 0 ${size.width} ${size.height}`);
    shown.setAttribute("role", "img");
    const said = document.createElement("p");
    box.prepend(shown);
    box.append(said);
    const update = () => {
      const values = {};
      for (const input of box.querySelectorAll("input")) {
        values[input.name] = Number(input.value);
        input.nextElementSibling.textContent = input.value + (input.dataset.unit || "");
      }
      const { svg, text } = drawings[box.dataset.plot](values);
      const ground = `<line class="ground" x1="20" y1="${size.y}" x2="${size.width - 20}" y2="${size.y}"/>`;
      shown.innerHTML = ground + svg;
      said.textContent = text;
    };
    box.addEventListener("input", update);
    update();
  }
});
