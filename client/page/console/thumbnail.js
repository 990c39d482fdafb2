// A map from above on a small canvas, in the colours of the page.

import { resolvedColour } from "../shared/colours.js";
import { STRIDE_LANDMARK, STRIDE_VIEW } from "./scene_data.js";

const MARGIN = 0.06; // of the picture, on each side
const SHOWN = [0.01, 0.99]; // the quantiles of landmarks that the picture is made to hold
const POINT_SIZE = 0.06; // map units, as wide as a landmark is drawn, within
const POINT_PX = [1.5, 4];
const MIN_EXTENT = 1; // map units

/** Draw landmarks, walk and waypoints of a scene (of `readScene`) onto a canvas, as large as it is shown. */
export function drawFromAbove(canvas, scene, waypoints = []) {
  const ratio = Math.min(devicePixelRatio, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) =>
    Math.max(1, Math.round(size * ratio)),
  );
  Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  const place = placement(bounds(scene), width, height);
  drawLandmarks(context, scene, place, resolvedColour(canvas, "--muted"), ratio);
  drawWalk(context, scene.views, place, resolvedColour(canvas, "--ink"), ratio);
  context.fillStyle = resolvedColour(canvas, "--bad");
  for (const { position } of waypoints) {
    const [x, y] = place(position[0], position[1]);
    context.fillRect(x - 2.5 * ratio, y - 2.5 * ratio, 5 * ratio, 5 * ratio);
  }
}

/** What a picture holds: the bulk of the landmarks, and all of the walk. `[[west, east], [south, north]]` */
export function bounds({ landmarks, views }) {
  return [0, 1].map((axis) => {
    const values = every(landmarks, STRIDE_LANDMARK, axis).sort();
    const walked = every(views, STRIDE_VIEW, axis);
    const ends = SHOWN.map((share) => values[Math.round(share * (values.length - 1))]);
    const all = [...ends, ...walked].filter(Number.isFinite);
    return all.length ? [Math.min(...all), Math.max(...all)] : [-1, 1];
  });
}

/**
 * Map coordinates → pixels: north is up, both axes have one scale, and the bounds fill the picture.
 * @param {number[][]} bounds
 * @param {number} width
 * @param {number} height
 */
export function placement([[west, east], [south, north]], width, height) {
  const [across, along] = [Math.max(east - west, MIN_EXTENT), Math.max(north - south, MIN_EXTENT)];
  const scale = (1 - 2 * MARGIN) * Math.min(width / across, height / along);
  const [x0, y0] = [(west + east) / 2, (south + north) / 2];
  return (x, y) => [width / 2 + scale * (x - x0), height / 2 - scale * (y - y0)];
}

const every = (numbers, stride, at) =>
  Float32Array.from({ length: numbers.length / stride }, (_, i) => numbers[i * stride + at]);

function drawLandmarks(context, { landmarks, colours }, place, ink, ratio) {
  const perUnit = place(1, 0)[0] - place(0, 0)[0];
  const size = ratio * Math.min(POINT_PX[1], Math.max(POINT_PX[0], (POINT_SIZE * perUnit) / ratio));
  context.globalAlpha = colours ? 1 : 0.6;
  context.fillStyle = ink;
  for (let i = 0; i * STRIDE_LANDMARK < landmarks.length; i++) {
    const [x, y] = place(landmarks[i * STRIDE_LANDMARK], landmarks[i * STRIDE_LANDMARK + 1]);
    if (colours) context.fillStyle = `rgb(${colours[3 * i]} ${colours[3 * i + 1]} ${colours[3 * i + 2]})`;
    context.fillRect(x - size / 2, y - size / 2, size, size);
  }
  context.globalAlpha = 1;
}

function drawWalk(context, views, place, ink, ratio) {
  context.strokeStyle = ink;
  context.lineWidth = 1.5 * ratio;
  context.lineJoin = context.lineCap = "round";
  context.beginPath();
  for (let i = 0; i < views.length; i += STRIDE_VIEW) {
    const sameWalk = i > 0 && views[i + 6] === views[i + 6 - STRIDE_VIEW];
    const [x, y] = place(views[i], views[i + 1]);
    if (!sameWalk) context.moveTo(x, y);
    context.lineTo(x, y); // a view by itself is a dot
  }
  context.stroke();
}
