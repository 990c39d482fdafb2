// A map in parallel projection, from above or from a side, to point and draw on: metres are the same everywhere.

import { resolvedColour } from "../shared/colours.js";
import { h } from "../shared/dom.js";
import { dot } from "./matrix.js";
import { STRIDE_LANDMARK, STRIDE_VIEW } from "./scene_data.js";

const MARGIN = 0.08; // of the canvas, on each side
const SHOWN = [0.01, 0.99]; // the quantiles of landmarks that the first look holds
const LEAST_EXTENT = 1; // map units
const CLICK_PX = 4; // how far a pointer may move in a click
const AXIS_PX = 46;
const GRID = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
const GRID_PX = 40; // between lines, at the least

/** Where one looks from: what is right and what is up in the picture, as axes of the map. */
export const Side = Object.freeze({
  ABOVE: { right: [1, 0, 0], up: [0, 1, 0], names: ["x", "y"] },
  SOUTH: { right: [1, 0, 0], up: [0, 0, 1], names: ["x", "z"] },
  EAST: { right: [0, 1, 0], up: [0, 0, 1], names: ["y", "z"] },
});

/** A canvas that shows a scene of `readScene`; `drawn(points, done)` hears of what the pointer draws, `clicked(point)` of clicks. */
export class PlanView {
  constructor(label, { drawn = (_points, _done) => {}, clicked = (_point) => {} } = {}) {
    this.drawn = drawn;
    this.clicked = clicked;
    this.scene = null;
    this.unit = "m";
    this.side = Side.ABOVE;
    this.figure = {};
    this.canvas = h("canvas", { class: "plan-view", role: "img", tabindex: 0, "aria-label": label });
    this.base = document.createElement("canvas");
    this.observer = new ResizeObserver(() => this.draw(true));
    this.observer.observe(this.canvas);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener("change", (this.recolour = () => this.draw(true)));
    listen(this);
  }

  dispose() {
    this.observer.disconnect();
    this.scheme.removeEventListener("change", this.recolour);
  }

  /** Show a scene; `names` are points and areas as the service gives them, `marks` further named positions. */
  show(scene, names = { points: [], areas: [] }, marks = []) {
    this.scene = scene;
    this.names = names;
    this.marks = marks;
    this.look(this.side);
  }

  /** Look from a side, at all of it. */
  look(side) {
    this.side = side;
    if (!this.scene) return;
    const [across, along] = [side.right, side.up].map((axis) => extent(this.scene, axis));
    this.middle = [(across[0] + across[1]) / 2, (along[0] + along[1]) / 2];
    this.span = [across, along].map(([low, high]) => Math.max(high - low, LEAST_EXTENT));
    this.zoomed = 1;
    this.draw(true);
  }

  /**
   * What is drawn over the map: `line` and `polygon` are lists of points, `point` is one, `piece` the first and last view
   * of a piece of the walk, `plan` a picture and where it lies.
   */
  set(figure) {
    const before = this.figure;
    this.figure = figure;
    this.draw(before.plan !== figure.plan);
  }

  get scale() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return this.zoomed * (1 - 2 * MARGIN) * Math.min(width / this.span[0], height / this.span[1]);
  }

  /** Map → pixels of the canvas. */
  place(point) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const [x, y] = [dot(point, this.side.right), dot(point, this.side.up)];
    return [width / 2 + this.scale * (x - this.middle[0]), height / 2 - this.scale * (y - this.middle[1])];
  }

  /** Pixels of the canvas → map; the coordinate that is not seen is 0. */
  pointAt(px, py) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const x = this.middle[0] + (px - width / 2) / this.scale;
    const y = this.middle[1] - (py - height / 2) / this.scale;
    return [0, 1, 2].map((i) => x * this.side.right[i] + y * this.side.up[i]);
  }

  /** The number of the view nearest to a point, as it is seen from here. */
  nearestView(point) {
    const [x, y] = this.place(point);
    const { views } = this.scene;
    let [best, least] = [0, Infinity];
    for (let i = 0; i < views.length; i += STRIDE_VIEW) {
      const [vx, vy] = this.place(views.subarray(i, i + 3));
      const apart = Math.hypot(vx - x, vy - y);
      if (apart < least) [best, least] = [i / STRIDE_VIEW, apart];
    }
    return best;
  }

  zoom(factor, px, py) {
    const before = this.pointAt(px, py);
    this.zoomed = Math.min(200, Math.max(0.2, this.zoomed * factor));
    const after = this.pointAt(px, py);
    const moved = before.map((value, i) => value - after[i]);
    this.middle = [this.middle[0] + dot(moved, this.side.right), this.middle[1] + dot(moved, this.side.up)];
    this.draw(true);
  }

  pan(dx, dy) {
    this.middle = [this.middle[0] - dx / this.scale, this.middle[1] + dy / this.scale];
    this.draw(true);
  }

  draw(anew = false) {
    this.stale ||= anew;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      if (this.canvas.isConnected && this.scene) this.drawNow();
    });
  }

  drawNow() {
    const { canvas, base } = this;
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const colour = (token) => resolvedColour(canvas, token);
    if (this.stale) {
      Object.assign(base, { width: canvas.width, height: canvas.height });
      const below = base.getContext("2d");
      below.scale(ratio, ratio);
      this.drawMap(below, colour);
      this.stale = false;
    }
    const context = canvas.getContext("2d");
    context.drawImage(base, 0, 0);
    context.scale(ratio, ratio);
    this.drawFigure(context, colour);
  }

  drawMap(context, colour) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    context.fillStyle = colour("--surface");
    context.fillRect(0, 0, width, height);
    const { plan } = this.figure;
    if (plan && this.side === Side.ABOVE)
      drawFloorPlan(context, plan, pair(this.place([...plan.corner, 0])), this.scale, colour("--accent"));
    this.drawGrid(context, colour);
    const { landmarks, colours, views } = this.scene;
    context.fillStyle = colour("--muted");
    for (let i = 0; i * STRIDE_LANDMARK < landmarks.length; i++) {
      const [x, y] = this.place(landmarks.subarray(STRIDE_LANDMARK * i, STRIDE_LANDMARK * i + 3));
      if (x < 0 || y < 0 || x > width || y > height) continue;
      if (colours) context.fillStyle = `rgb(${colours[3 * i]} ${colours[3 * i + 1]} ${colours[3 * i + 2]})`;
      context.fillRect(x - 1, y - 1, 2, 2);
    }
    context.strokeStyle = colour("--ink");
    context.lineWidth = 1.5;
    context.lineCap = "round";
    this.trace(context, views, 0, views.length / STRIDE_VIEW - 1);
    this.drawNames(context, colour);
  }

  /** The walk from one view to another as a line. */
  trace(context, views, first, last) {
    context.beginPath();
    for (let k = first; k <= last; k++) {
      const i = k * STRIDE_VIEW;
      const goesOn = k > first && views[i + 6] === views[i + 6 - STRIDE_VIEW];
      const [x, y] = this.place(views.subarray(i, i + 3));
      if (!goesOn) context.moveTo(x, y);
      context.lineTo(x, y); // a view by itself is a dot
    }
    context.stroke();
  }

  drawGrid(context, colour) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const step = GRID.find((one) => one * this.scale >= GRID_PX) ?? GRID.at(-1);
    const [low, high] = [this.pointAt(0, height), this.pointAt(width, 0)];
    context.strokeStyle = colour("--line");
    context.lineWidth = 0.5;
    context.beginPath();
    for (const [axis, other] of [
      [this.side.right, this.side.up],
      [this.side.up, this.side.right],
    ]) {
      for (let at = Math.ceil(dot(low, axis) / step) * step; at <= dot(high, axis); at += step) {
        const ends = [dot(low, other), dot(high, other)].map((value) => axis.map((a, i) => a * at + other[i] * value));
        context.moveTo(...pair(this.place(ends[0])));
        context.lineTo(...pair(this.place(ends[1])));
      }
    }
    context.stroke();
    this.drawAxes(context, [0, 0, 0], [this.side.right, this.side.up], colour("--accent"), colour("--ink"));
    context.fillStyle = colour("--muted");
    context.font = "12px system-ui, sans-serif";
    context.fillText(`▦ ${step} ${this.unit}`, 8, height - 8);
  }

  drawAxes(context, origin, axes, stroke, ink) {
    const [ox, oy] = this.place(origin);
    context.strokeStyle = stroke;
    context.fillStyle = ink;
    context.lineWidth = 2.5;
    context.font = "600 13px system-ui, sans-serif";
    axes.forEach((axis, i) => {
      const [dx, dy] = [dot(axis, this.side.right), -dot(axis, this.side.up)];
      arrow(context, [ox, oy], [ox + AXIS_PX * dx, oy + AXIS_PX * dy]);
      context.fillText(this.side.names[i], ox + (AXIS_PX + 8) * dx - 4, oy + (AXIS_PX + 8) * dy + 4);
    });
  }

  drawNames(context, colour) {
    context.font = "600 13px system-ui, sans-serif";
    if (this.side === Side.ABOVE) {
      for (const { name, outline } of this.names.areas) {
        const corners = outline.map(([x, y]) => this.place([x, y, 0]));
        context.strokeStyle = colour("--accent");
        context.lineWidth = 1.5;
        outlineOf(context, corners);
        context.stroke();
        write(context, name, middleOf(corners), colour);
      }
    }
    const points = [...this.names.points, ...this.marks];
    for (const { name, position } of points) {
      const [x, y] = this.place(position);
      context.fillStyle = colour("--bad");
      context.fillRect(x - 3, y - 3, 6, 6);
      write(context, name, [x + 8, y - 6], colour, "left");
    }
  }

  drawFigure(context, colour) {
    const { line, polygon, point, piece, pins } = this.figure;
    context.strokeStyle = context.fillStyle = colour("--bad");
    context.lineWidth = 3;
    if (line) arrow(context, this.place(line[0]), this.place(line[1]));
    if (polygon?.length) {
      const corners = polygon.map((corner) => this.place(corner));
      outlineOf(context, corners);
      context.stroke();
      context.globalAlpha = 0.15;
      context.fill();
      context.globalAlpha = 1;
      for (const [x, y] of corners) context.fillRect(x - 3, y - 3, 6, 6);
    }
    if (point) this.drawAxes(context, point, [this.side.right, this.side.up], colour("--bad"), colour("--bad"));
    if (piece) {
      context.lineWidth = 6;
      this.trace(context, this.scene.views, ...piece);
      for (const k of piece) {
        const [x, y] = this.place(this.scene.views.subarray(k * STRIDE_VIEW, k * STRIDE_VIEW + 3));
        context.beginPath();
        context.arc(x, y, 6, 0, 2 * Math.PI);
        context.fill();
      }
    }
    for (const [i, pin] of (pins ?? []).entries()) drawPin(context, this.place(pin), "AB"[i], colour);
  }
}

/**
 * A floor plan under a map, seen from above with y up: `corner` is where its lower left corner lies, in pixels, `scale` the
 * pixels of a metre.
 */
export function drawFloorPlan(context, { image, inColour, lines, turn, perPixel }, corner, scale, stroke) {
  const size = perPixel * scale;
  context.save();
  context.translate(...corner);
  context.rotate(-turn);
  if (image) {
    context.globalAlpha = 0.6;
    if (!inColour && matchMedia("(prefers-color-scheme: dark)").matches)
      context.filter = "invert(1) hue-rotate(180deg)";
    context.drawImage(image, 0, -image.height * size, image.width * size, image.height * size);
  }
  context.strokeStyle = stroke;
  context.lineWidth = 1.5;
  for (const line of lines ?? []) {
    context.beginPath();
    for (const [x, y] of line) context.lineTo(x * size, -y * size);
    context.stroke();
  }
  context.restore();
}

/** A lettered mark. */
export function drawPin(context, at, letter, colour) {
  const [x, y] = at;
  context.fillStyle = colour("--bad");
  context.beginPath();
  context.arc(x, y, 5, 0, 2 * Math.PI);
  context.fill();
  write(context, letter, [x + 9, y - 7], colour, "left");
}

function listen(view) {
  const { canvas } = view;
  const fingers = new Map();
  let start = null;
  const at = (event) => view.pointAt(event.offsetX, event.offsetY);
  canvas.addEventListener("pointerdown", (event) => {
    if (!view.scene) return;
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    const draws = event.button === 0 && !event.shiftKey && fingers.size === 1;
    start = draws ? { x: event.offsetX, y: event.offsetY, point: at(event), moved: false } : null;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    fingers.set(event.pointerId, event);
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (fingers.size > 1) {
      const [a, b] = [...fingers.values()];
      const other = a.pointerId === event.pointerId ? b : a;
      const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) || 1;
      view.zoom(apart(event) / apart(before), event.offsetX, event.offsetY);
      view.pan(dx / 2, dy / 2);
    } else if (!start) view.pan(dx, dy);
    else {
      start.moved ||= Math.hypot(event.offsetX - start.x, event.offsetY - start.y) > CLICK_PX;
      if (start.moved) view.drawn([start.point, at(event)], false);
    }
  });
  const end = (event) => {
    const known = fingers.delete(event.pointerId);
    if (!known || !start) return;
    if (event.type === "pointerup")
      start.moved ? view.drawn([start.point, at(event)], true) : view.clicked(start.point);
    start = null;
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const notches = Math.max(-100, Math.min(100, event.deltaY));
      view.zoom(Math.exp(-notches * 0.002), event.offsetX, event.offsetY);
    },
    { passive: false },
  );
  const keys = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
  canvas.addEventListener("keydown", (event) => {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (keys[event.key]) view.pan(...pair(keys[event.key]));
    else if (event.key === "+" || event.key === "=") view.zoom(1.25, width / 2, height / 2);
    else if (event.key === "-") view.zoom(0.8, width / 2, height / 2);
    else if (event.key === "Home") view.look(view.side);
    else return;
    event.preventDefault();
  });
}

/** @type {(two: number[]) => [number, number]} */
const pair = ([x, y]) => [x, y];

function extent({ landmarks, views }, axis) {
  const along = (numbers, stride) =>
    Float32Array.from({ length: numbers.length / stride }, (_, i) =>
      dot(numbers.subarray(i * stride, i * stride + 3), axis),
    ).sort();
  const [values, walked] = [along(landmarks, STRIDE_LANDMARK), along(views, STRIDE_VIEW)];
  const ends = SHOWN.map((share) => values[Math.round(share * (values.length - 1))]);
  const all = [...ends, walked[0], walked.at(-1)].filter(Number.isFinite);
  return all.length ? [Math.min(...all), Math.max(...all)] : [-1, 1];
}

/** @type {(context: CanvasRenderingContext2D, from: number[], to: number[]) => void} */
function arrow(context, [x0, y0], [x1, y1]) {
  const angle = Math.atan2(y1 - y0, x1 - x0);
  const back = (side) => [x1 - 10 * Math.cos(angle + side), y1 - 10 * Math.sin(angle + side)];
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.moveTo(...pair(back(0.45)));
  context.lineTo(x1, y1);
  context.lineTo(...pair(back(-0.45)));
  context.stroke();
}

function outlineOf(context, corners) {
  context.beginPath();
  corners.forEach(([x, y], i) => {
    if (i) context.lineTo(x, y);
    else context.moveTo(x, y);
  });
  context.closePath();
}

const middleOf = (corners) => [0, 1].map((i) => corners.reduce((sum, corner) => sum + corner[i], 0) / corners.length);

function write(context, text, at, colour, align = /** @type {CanvasTextAlign} */ ("center")) {
  const [x, y] = at;
  context.textAlign = align;
  context.lineWidth = 3;
  context.strokeStyle = colour("--surface");
  context.strokeText(text, x, y);
  context.fillStyle = colour("--ink");
  context.fillText(text, x, y);
  context.textAlign = "left";
}
