// A floor plan as lines on a map's floor: the lines of GeoJSON, or of a picture what stands out from its ground.

import { h } from "../shared/dom.js";
import { segments } from "./scene_lines.js";

const ROWS = 400; // that the longer side of a picture is looked at in
const STANDS_OUT = 60; // of 255, against the ground

/** The ends of lines, three numbers each, of a plan as `keptPlan` gives it, at a height. */
export function planLines({ image, lines, corner, turn, perPixel }, z) {
  const [cos, sin] = [Math.cos(turn) * perPixel, Math.sin(turn) * perPixel];
  const placed = ([x, y]) => [corner[0] + cos * x - sin * y, corner[1] + sin * x + cos * y, z];
  if (!image) return lines.flatMap((line) => segments(line.map(placed)));
  const { width, height } = image;
  const step = Math.max(1, Math.max(width, height) / ROWS);
  const [across, down] = [width, height].map((size) => Math.max(1, Math.round(size / step)));
  return strokes(greyOf(image, across, down), across, down).flatMap(([from, to, row]) => {
    const y = height - (row + 0.5) * step;
    return [...placed([from * step, y]), ...placed([to * step, y])];
  });
}

/** Of grey levels, row by row, where each stretch begins and ends that stands out from the ground, and its row. */
export function strokes(grey, across, down) {
  const ground = [...grey].sort((a, b) => a - b)[grey.length >> 1];
  const found = [];
  for (let row = 0; row < down; row++) {
    let from = -1;
    for (let x = 0; x <= across; x++) {
      const out = x < across && Math.abs(grey[row * across + x] - ground) > STANDS_OUT;
      if (out && from < 0) from = x;
      if (!out && from >= 0) {
        found.push([from, x, row]);
        from = -1;
      }
    }
  }
  return found;
}

/** The levels of a picture made smaller, 0 to 255; what is transparent is white. */
function greyOf(image, width, height) {
  const context = h("canvas", { width, height }).getContext("2d", { willReadFrequently: true });
  context.fillStyle = "white";
  context.fillRect(0, 0, width, height);
  context.drawImage(image, 0, 0, width, height);
  const { data } = context.getImageData(0, 0, width, height);
  return Uint8Array.from(
    { length: width * height },
    (_, i) => (data[4 * i] + 2 * data[4 * i + 1] + data[4 * i + 2]) / 4,
  );
}
