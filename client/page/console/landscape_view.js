// The landscape around a pose: what the densities say of positions near it, from above, and the ways that ascents climb.

import { action, h } from "../shared/dom.js";
import { decimal, t } from "../shared/text.js";

const SIZE = 480; // px, of the drawing's sides
const STEP_MS = 90; // between two steps of an ascent
const RAMP = [
  [0, 0, 4],
  [81, 18, 124],
  [183, 55, 121],
  [252, 137, 97],
  [252, 253, 191],
]; // from nothing to the most, dark to bright
const WAY = "#9aa5b1";
const BEST_WAY = "#7fd1c7";
const POSE = "#ffffff";
const ARROW = 0.12; // of the drawing's side

/**
 * The drawing with what it shows in words; `seen` is what `/v1/maps/{map}/landscape` answers. The ascents are played, unless
 * the browser is asked for calm.
 */
export function landscapeView(seen, signal) {
  if (!seen.values.length) return h("p", { class: "muted" }, t`Too little in the picture matches to climb by.`);
  const canvas = h("canvas", {
    class: "landscape",
    width: SIZE,
    height: SIZE,
    role: "img",
    "aria-label": summary(seen),
  });
  const ground = heights(seen.values);
  const longest = Math.max(...seen.ways.map(({ positions }) => positions.length));
  const draw = (steps) => drawLandscape(canvas, ground, seen, steps);
  let playing = 0;
  const play = () => {
    const mine = ++playing;
    const began = performance.now();
    const next = (now) => {
      if (mine !== playing || signal.aborted) return;
      const steps = 1 + (now - began) / STEP_MS;
      draw(steps);
      if (steps < longest) requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  };
  draw(longest);
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play();
  return h(
    "section",
    { class: "stack", "aria-label": t`Landscape` },
    canvas,
    h("p", { class: "small" }, summary(seen)),
    h("div", { class: "row" }, action(t`Play the ascents`, play)),
  );
}

/** What the drawing shows, in a sentence. */
export function summary({ values, spacing, ways, scale, localized }) {
  const wide = decimal((values.length - 1) * spacing, 1);
  const unit = scale === "metric" ? "m" : t`units`;
  return localized
    ? t`Positions around the pose, ${wide} ${unit} wide, from above: the brighter, the better they explain the picture. ${ways.length} ascents.`
    : t`No pose, but the best optimum: positions around it, ${wide} ${unit} wide, from above. ${ways.length} ascents.`;
}

/** The values (rows of increasing y) as a picture, a pixel each, north up. */
export function heights(values) {
  const [height, width] = [values.length, values[0].length];
  const most = Math.max(...values.flat(), 1e-9);
  const pixels = new Uint8ClampedArray(4 * width * height);
  values.forEach((row, y) => {
    row.forEach((value, x) => {
      pixels.set([...colourOf(value / most), 255], 4 * ((height - 1 - y) * width + x));
    });
  });
  return { width, height, pixels };
}

/** The ramp's colour at a share from 0 to 1. */
function colourOf(share) {
  const place = Math.min(1, Math.max(0, share)) * (RAMP.length - 1);
  const below = Math.min(Math.floor(place), RAMP.length - 2);
  return RAMP[below].map((value, i) => Math.round(value + (place - below) * (RAMP[below + 1][i] - value)));
}

/** Draw the ground and so many steps of every way. */
function drawLandscape(canvas, ground, { origin, spacing, ways, pose }, steps) {
  const context = canvas.getContext("2d");
  const image = h("canvas", { width: ground.width, height: ground.height });
  image.getContext("2d").putImageData(new ImageData(ground.pixels, ground.width, ground.height), 0, 0);
  context.drawImage(image, 0, 0, canvas.width, canvas.height);
  const cell = canvas.width / ground.width;
  const at = ([x, y]) => [
    ((x - origin[0]) / spacing + 0.5) * cell,
    canvas.height - ((y - origin[1]) / spacing + 0.5) * cell,
  ];
  context.lineWidth = 2;
  ways.forEach(({ positions }, i) => {
    context.strokeStyle = i === ways.length - 1 ? BEST_WAY : WAY;
    const [first, ...others] = positions.slice(0, Math.ceil(steps)).map(at);
    context.beginPath();
    context.arc(...first, 6, 0, 2 * Math.PI);
    context.moveTo(...first);
    for (const place of others) context.lineTo(...place);
    context.stroke();
  });
  const [u, v] = at(pose.position);
  const [dx, dy] = pose.heading.map((value) => value * ARROW * canvas.width);
  context.strokeStyle = POSE;
  context.beginPath();
  context.arc(u, v, 4, 0, 2 * Math.PI);
  context.moveTo(u, v);
  context.lineTo(u + dx, v - dy);
  context.stroke();
}
