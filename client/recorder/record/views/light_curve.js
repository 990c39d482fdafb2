// The light so far, as a curve.

import { DARKEST } from "../coaching.js";

const SVG = "http://www.w3.org/2000/svg";
const [WIDTH, HEIGHT] = [100, 24];

/** An element, and `show(lights)` that draws brightnesses, 0 to 1, from the first to the last. */
export function lightCurve() {
  const limit = shape("line", { x1: 0, x2: WIDTH, y1: height(DARKEST), y2: height(DARKEST), class: "limit" });
  const curve = shape("polyline", { points: "" });
  const element = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", class: "light", role: "img", "aria-label": "The light so far" });
  element.append(limit, curve);
  const show = (lights) => {
    const step = WIDTH / Math.max(1, lights.length - 1);
    curve.setAttribute("points", lights.map((light, i) => `${(i * step).toFixed(1)},${height(light)}`).join(" "));
  };
  return { element, show };
}

const height = (light) => (HEIGHT * (1 - light)).toFixed(1);

function shape(tag, attributes) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}
