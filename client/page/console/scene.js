// A map in 3-D: landmarks in the colours of the pictures or by uncertainty, the walk, waypoints, the map's axes, and the pose
// that was found. WebGL, z up.

import { resolvedColour } from "../shared/colours.js";
import { h } from "../shared/dom.js";
import { t } from "../shared/text.js";
import { length } from "./format.js";
import { lookAt, multiply, perspective, project } from "./matrix.js";
import { STRIDE_LANDMARK, STRIDE_VIEW } from "./scene_data.js";

const FIELD_OF_VIEW = 0.9; // rad
const SHOWN = [0.02, 0.98]; // the quantiles of landmarks that the first view holds, and of deviations that the colours tell
const HEADING_LENGTH = 0.25; // m, of a view's tick
const MAX_TILT = 1.55; // rad, nearly straight down
const FRUSTUM = 0.5; // m, how far the drawn camera reaches
const EXTENTS = [0.6, 0.45]; // of a camera of which nothing is known
const SMOOTH_MS = [20, 34]; // how far apart pictures may be while the map moves; fewer landmarks are drawn, or more
const LEAST_DRAWN = 2000; // landmarks, while the map moves
const REST_MS = 150; // after which a map that was moved rests, and all of it is drawn
const MAX_FLOOR = 10_000; // square metres that are drawn
const MAX_RAYS = 150; // the most lines from the camera to landmarks

const AXIS = 0.5; // m, of the axes at the origin
const PICK_PX = 14; // how near a click must be to its target
const CLICK_PX = 5; // how far a pointer may move in a click
/** @type {[string, number[], number[]][]} */
const AXES = [
  ["x", [1, 0, 0], [0.84, 0.2, 0.2]],
  ["y", [0, 1, 0], [0.15, 0.55, 0.2]],
  ["z", [0, 0, 1], [0.2, 0.4, 0.9]],
];

const POINT_SHADER = `
  attribute vec4 point; attribute vec3 picture; uniform mat4 matrix; uniform float size; uniform vec2 deviations;
  uniform float coloured; varying vec3 colour;
  void main() {
    gl_Position = matrix * vec4(point.xyz, 1.0);
    gl_PointSize = clamp(size / gl_Position.w, 1.5, 12.0);
    float t = clamp((log(point.w) - deviations.x) / (deviations.y - deviations.x), 0.0, 1.0);
    vec3 sure = vec3(0.16, 0.47, 0.86), middle = vec3(0.66, 0.52, 0.66), unsure = vec3(0.93, 0.49, 0.10);
    vec3 certainty = t < 0.5 ? mix(sure, middle, 2.0 * t) : mix(middle, unsure, 2.0 * t - 1.0);
    colour = mix(certainty, picture, coloured);
  }`;
const POINT_COLOUR = "precision mediump float; varying vec3 colour; void main() { gl_FragColor = vec4(colour, 1.0); }";
const LINE_SHADER =
  "attribute vec3 point; uniform mat4 matrix; void main() { gl_Position = matrix * vec4(point, 1.0); }";
const LINE_COLOUR = "precision mediump float; uniform vec4 colour; void main() { gl_FragColor = colour; }";

/** An element that shows a scene; `element` is put into a page, `show…` says what of, `dispose` ends it. */
export class SceneView {
  constructor(label) {
    this.canvas = h("canvas", {
      class: "scene-canvas",
      tabindex: 0,
      role: "img",
      "aria-label": t`${label}. Arrow keys turn, shift and arrow keys move, plus and minus zoom, Home resets.`,
    });
    this.labels = h("div", { class: "scene-labels", "aria-hidden": "true" });
    this.legend = h("div", { class: "scene-legend small", hidden: true });
    this.said = h("p", { class: "scene-said small", role: "status", hidden: true });
    this.paint = h("button", { type: "button", hidden: true, onclick: () => this.colourBy(!this.coloured) });
    this.tools = h(
      "div",
      { class: "scene-tools" },
      h("button", { type: "button", onclick: () => this.lookDown() }, t`From above`),
      h("button", { type: "button", onclick: () => this.reset() }, t`Whole room`),
      this.paint,
    );
    this.element = h("div", { class: "scene" }, this.canvas, this.labels, this.tools, this.said, this.legend);
    this.lines = {};
    this.colours = {};
    this.waypoints = [];
    this.robots = new Map(); // labels and positions, by asker
    this.coloured = false;
    this.view = { target: [0, 0, 0], distance: 5, turn: -0.9, tilt: 0.6 };
    this.home = this.view;
    this.gl = this.canvas.getContext("webgl", { alpha: false, antialias: false, powerPreference: "low-power" });
    if (!this.gl) {
      this.element.append(
        h("p", { class: "notice warn" }, t`This browser has no WebGL, so the map cannot be drawn in 3-D.`),
      );
      return;
    }
    this.points = program(this.gl, POINT_SHADER, POINT_COLOUR);
    this.strokes = program(this.gl, LINE_SHADER, LINE_COLOUR);
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(this.canvas);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener(
      "change",
      (this.recolour = () => {
        this.colours = {};
        this.redraw();
      }),
    );
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => location.reload());
    listen(this);
  }

  dispose() {
    this.observer?.disconnect();
    this.scheme?.removeEventListener("change", this.recolour);
    cancelAnimationFrame(this.frame);
    clearTimeout(this.rest);
    this.gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }

  /** Show a map; `waypoints` as the service gives them, `unit` is the unit of lengths. */
  showMap(scene, waypoints, metric, names = { points: [], areas: [] }) {
    if (!this.gl) return;
    const { gl } = this;
    this.count = this.budget = scene.features;
    this.scene = scene;
    this.metric = metric;
    const order = shuffledOrder(scene.features); // so that the first of them are a fair choice
    this.buffer = upload(gl, inOrder(scene.landmarks, STRIDE_LANDMARK, order));
    this.pictureColours = scene.colours && upload(gl, inOrder(scene.colours, 3, order));
    const deviations = quantiles(scene.landmarks, 3, SHOWN);
    this.deviations = deviations.map((value) => Math.log(Math.max(value, 1e-4)));
    if (this.deviations[1] - this.deviations[0] < 0.1) this.deviations[1] = this.deviations[0] + 0.1;
    this.waypoints = waypoints.map(({ name, position, residual_m: residual }) => ({
      position,
      label: h("span", { class: "scene-waypoint" }, residual === null ? name : `${name} · ${length(residual, metric)}`),
    }));
    const tips = AXES.map(([name, axis]) => ({
      position: axis.map((value) => AXIS * value),
      label: h("span", { class: "scene-axis" }, name),
    }));
    this.waypoints.push(...tips, ...named(names, floorOf(scene.landmarks)));
    this.labels.replaceChildren(...this.waypoints.map(({ label }) => label));
    this.legend.replaceChildren(
      t`uncertainty `,
      h("span", { class: "mono" }, length(deviations[0], metric)),
      h("span", { class: "scene-ramp" }),
      h("span", { class: "mono" }, length(deviations[1], metric)),
    );
    this.colourBy(scene.colours !== null);
    this.paint.hidden = !scene.colours;
    for (const [name, axis, colour] of AXES)
      this.setLines(`axis ${name}`, colour, [0, 0, 0, ...axis.map((value) => AXIS * value)]);
    this.setLines("floor", "--line", floor(scene.landmarks));
    this.setLines("areas", "--accent", outlines(names.areas, floorOf(scene.landmarks)));
    this.setLines("walk", "--ink", walk(scene.views));
    this.setLines("headings", "--muted", headings(scene.views));
    this.lookAtAll(scene);
  }

  /** Paint landmarks in the colours of the pictures, or by how uncertain they are. */
  colourBy(pictures) {
    this.coloured = pictures;
    this.paint.textContent = pictures ? t`Colour by uncertainty` : t`Colours of the pictures`;
    this.legend.hidden = pictures || !this.scene?.features;
    this.redraw();
  }

  /** Look straight down on the whole of it, north up. */
  lookDown() {
    this.view = { ...this.home, turn: -Math.PI / 2, tilt: MAX_TILT };
    this.redraw();
  }

  /** Say what is at a place of the canvas, and mark it. */
  pick(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const matrix = this.matrix(width / height);
    const found = nearest(this.scene, (point) => {
      const [px, py, w] = project(matrix, point);
      return w <= 0 ? Infinity : Math.hypot(((px + 1) / 2) * width - x, ((1 - py) / 2) * height - y);
    });
    this.said.hidden = !found;
    this.setLines("picked", "--accent", found ? cross(found.position, AXIS / 4) : []);
    if (found) this.said.textContent = sayPicked(found, this.metric);
  }

  /**
   * Show where a camera is and looks (`T_map_camera`, 4 × 4), or nothing; `landmarks` are those that it recognised,
   * `extents` how far its picture reaches on the plane one metre in front of it.
   */
  showPose(T, landmarks = [], extents = EXTENTS) {
    this.setLines("camera", "--accent", T ? frustum(T, extents) : []);
    const at = T?.slice(0, 3).map((row) => row[3]);
    const step = Math.max(1, Math.ceil(landmarks.length / MAX_RAYS));
    const seen = landmarks.filter((_, i) => i % step === 0);
    this.setLines("rays", "--accent", at ? seen.flatMap((landmark) => [...at, ...landmark]) : [], 0.2);
  }

  /** Show those who ask for poses: `{asker, T, localized, stale}`. */
  showRobots(robots) {
    if (!this.gl) return;
    const some = (chosen) => robots.filter(chosen).flatMap(({ T }) => frustum(T, EXTENTS));
    this.setLines(
      "robots",
      "--accent",
      some(({ localized, stale }) => localized && !stale),
    );
    this.setLines(
      "robots lost",
      "--bad",
      some(({ localized, stale }) => !localized && !stale),
    );
    this.setLines(
      "robots gone",
      "--muted",
      some(({ stale }) => stale),
      0.5,
    );
    const names = new Set(robots.map(({ asker }) => asker));
    for (const [asker, { label }] of this.robots) {
      if (names.has(asker)) continue;
      label.remove();
      this.robots.delete(asker);
    }
    for (const { asker, T } of robots) {
      if (!this.robots.has(asker)) {
        const label = h("span", { class: "scene-robot" }, asker);
        this.labels.append(label);
        this.robots.set(asker, { label });
      }
      this.robots.get(asker).position = T.slice(0, 3).map((row) => row[3]);
    }
  }

  /** Show a path as a line: `positions` is a list of [x, y, z]. */
  showTrail(positions) {
    this.setLines("trail", "--warn", segments(positions));
  }

  setLines(name, token, vertices, alpha = 1) {
    if (!this.gl) return;
    if (this.lines[name]) this.gl.deleteBuffer(this.lines[name].buffer);
    const numbers = new Float32Array(vertices);
    this.lines[name] = { token, alpha, count: numbers.length / 3, buffer: upload(this.gl, numbers) };
    this.redraw();
  }

  lookAtAll({ landmarks, views }) {
    const spans = [0, 1, 2].map((axis) => {
      const ends = views.length ? quantiles(views, axis, [0, 1], STRIDE_VIEW) : [];
      if (landmarks.length) ends.push(...quantiles(landmarks, axis, SHOWN));
      return ends.length ? [Math.min(...ends), Math.max(...ends)] : [-1, 1];
    });
    const extent = Math.hypot(...spans.map(([low, high]) => high - low)) || 1;
    this.home = { ...this.home, target: spans.map(([low, high]) => (low + high) / 2), distance: extent };
    this.reset();
  }

  reset() {
    this.view = { ...this.home };
    this.redraw();
  }

  turn(by, tilt) {
    this.view.turn += by;
    this.view.tilt = Math.min(MAX_TILT, Math.max(-MAX_TILT, this.view.tilt + tilt));
    this.move();
  }

  zoom(factor) {
    this.view.distance = Math.min(500, Math.max(0.2, this.view.distance * factor));
    this.move();
  }

  /** Move what is looked at by parts of the picture's height. */
  pan(right, up) {
    const { turn, tilt, distance, target } = this.view;
    const span = 2 * distance * Math.tan(FIELD_OF_VIEW / 2);
    const across = [-Math.sin(turn), Math.cos(turn), 0];
    const above = [-Math.cos(turn) * Math.sin(tilt), -Math.sin(turn) * Math.sin(tilt), Math.cos(tilt)];
    this.view.target = target.map((value, i) => value + span * (right * across[i] + up * above[i]));
    this.move();
  }

  /** Draw while the user moves the map: as many landmarks as keep it smooth, and all of them once it rests. */
  move() {
    clearTimeout(this.rest);
    this.moving = true;
    this.rest = setTimeout(() => {
      this.moving = false;
      this.before = null;
      this.redraw();
    }, REST_MS);
    this.redraw();
  }

  redraw() {
    this.frame ??= requestAnimationFrame((now) => {
      this.frame = null;
      if (this.restless) this.keepSmooth(now);
      if (this.canvas.isConnected) this.draw();
    });
  }

  /** Whether picture follows picture: then no more landmarks are drawn than keep it smooth. */
  get restless() {
    return this.moving || this.robots.size > 0;
  }

  keepSmooth(now) {
    const took = now - (this.before ?? now - SMOOTH_MS[0]);
    const change = took > SMOOTH_MS[1] ? 0.7 : took < SMOOTH_MS[0] ? 1.2 : 1;
    this.budget = Math.min(this.count, Math.max(LEAST_DRAWN, Math.round(this.budget * change)));
    this.before = now;
  }

  draw() {
    const { gl, canvas } = this;
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((value) =>
      Math.max(1, Math.round(value * ratio)),
    );
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const matrix = this.matrix(width / height);
    gl.viewport(0, 0, width, height);
    gl.clearColor(...this.colour("--surface"), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    if (this.count) this.drawPoints(matrix, height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    for (const line of Object.values(this.lines)) this.drawLines(line, matrix);
    gl.disable(gl.BLEND);
    this.placeLabels(matrix);
  }

  drawPoints(matrix, height) {
    const { gl, points } = this;
    gl.useProgram(points.program);
    gl.uniformMatrix4fv(points.uniform("matrix"), false, matrix);
    gl.uniform1f(points.uniform("size"), 0.025 * height);
    gl.uniform2f(points.uniform("deviations"), ...this.deviations);
    gl.uniform1f(points.uniform("coloured"), this.coloured && this.pictureColours ? 1 : 0);
    points.bind(this.buffer, STRIDE_LANDMARK);
    if (this.pictureColours) points.bindColours(this.pictureColours);
    else gl.disableVertexAttribArray(1);
    gl.drawArrays(gl.POINTS, 0, this.restless ? this.budget : this.count);
  }

  drawLines({ token, alpha, count, buffer }, matrix) {
    if (!count) return;
    const { gl, strokes } = this;
    gl.useProgram(strokes.program);
    gl.uniformMatrix4fv(strokes.uniform("matrix"), false, matrix);
    gl.uniform4f(strokes.uniform("colour"), ...this.colour(token), alpha);
    strokes.bind(buffer, 3);
    gl.disableVertexAttribArray(1);
    gl.drawArrays(gl.LINES, 0, count);
  }

  /** A colour of the design, or one given as three numbers, as WebGL takes it. */
  colour(token) {
    if (Array.isArray(token)) return token;
    return (this.colours[token] ??= resolved(this.canvas, token));
  }

  placeLabels(matrix) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    for (const { position, label } of [...this.waypoints, ...this.robots.values()]) {
      const [x, y, w] = project(matrix, position);
      label.hidden = w <= 0 || Math.abs(x) > 1 || Math.abs(y) > 1;
      label.style.transform = `translate(${((x + 1) / 2) * width}px, ${((1 - y) / 2) * height}px)`;
    }
  }

  matrix(aspect) {
    const { target, distance, turn, tilt } = this.view;
    const away = [Math.cos(turn) * Math.cos(tilt), Math.sin(turn) * Math.cos(tilt), Math.sin(tilt)];
    const eye = target.map((value, i) => value + distance * away[i]);
    const fov = aspect < 1 ? 2 * Math.atan(Math.tan(FIELD_OF_VIEW / 2) / aspect) : FIELD_OF_VIEW;
    return multiply(perspective(fov, aspect, distance / 100, distance * 20), lookAt(eye, target));
  }
}

function listen(scene) {
  const { canvas } = scene;
  const fingers = new Map();
  const keys = {
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, 1],
    ArrowDown: [0, -1],
  };
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
    pressed = fingers.size === 1 ? event : null;
  });
  canvas.addEventListener("pointerup", (event) => {
    const moved = pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY);
    if (moved !== null && moved <= CLICK_PX && scene.scene) scene.pick(event.offsetX, event.offsetY);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY].map(
      (v) => v / canvas.clientHeight,
    );
    const others = [...fingers.values()].filter((one) => one.pointerId !== event.pointerId);
    if (others.length) {
      const apart = (one) => Math.hypot(one.clientX - others[0].clientX, one.clientY - others[0].clientY) || 1;
      scene.zoom(apart(before) / apart(event));
      scene.pan(-dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) scene.pan(-dx, dy);
    else scene.turn(-4 * dx, 4 * dy);
    fingers.set(event.pointerId, event);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      scene.zoom(Math.exp(Math.max(-100, Math.min(100, event.deltaY)) * 0.002));
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const [x, y] = keys[event.key] ?? [0, 0];
    if (x || y) event.shiftKey ? scene.pan(0.05 * x, 0.05 * y) : scene.turn(0.1 * x, 0.1 * y);
    else if (event.key === "+" || event.key === "=") scene.zoom(0.85);
    else if (event.key === "-") scene.zoom(1.18);
    else if (event.key === "Home") scene.reset();
    else return;
    event.preventDefault();
  });
}

/** Lines between consecutive views of one recording. */
function walk(views) {
  const lines = [];
  for (let i = STRIDE_VIEW; i < views.length; i += STRIDE_VIEW) {
    const before = i - STRIDE_VIEW;
    if (views[i + 6] === views[before + 6])
      lines.push(...views.subarray(before, before + 3), ...views.subarray(i, i + 3));
  }
  return lines;
}

/** A grid of square metres, at the height of the lowest landmarks. */
function floor(landmarks) {
  if (!landmarks.length) return [];
  const [[west, east], [south, north], [z]] = [0, 1, 2].map((axis) =>
    quantiles(landmarks, axis, SHOWN).map(Math.round),
  );
  if ((east - west) * (north - south) > MAX_FLOOR) return [];
  const lines = [];
  for (let x = west; x <= east; x++) lines.push(x, south, z, x, north, z);
  for (let y = south; y <= north; y++) lines.push(west, y, z, east, y, z);
  return lines;
}

/** The height of the lowest landmarks. */
const floorOf = (landmarks) => (landmarks.length ? quantiles(landmarks, 2, SHOWN)[0] : 0);

/** Labels of named points and areas, these in the middle of their floor. */
function named({ points, areas }, z) {
  const label = (name) => h("span", { class: "scene-name" }, name);
  const middle = (outline, axis) => outline.reduce((sum, corner) => sum + corner[axis], 0) / outline.length;
  return [
    ...points.map(({ name, position }) => ({ position, label: label(name) })),
    ...areas.map(({ name, outline }) => ({
      position: [middle(outline, 0), middle(outline, 1), z],
      label: label(name),
    })),
  ];
}

function outlines(areas, z) {
  return areas.flatMap(({ outline }) =>
    outline.flatMap((corner, i) => [...corner, z, ...outline[(i + 1) % outline.length], z]),
  );
}

function headings(views) {
  const lines = [];
  for (let i = 0; i < views.length; i += STRIDE_VIEW) {
    const position = views.subarray(i, i + 3);
    lines.push(...position, ...position.map((value, axis) => value + HEADING_LENGTH * views[i + 3 + axis]));
  }
  return lines;
}

function segments(positions) {
  return positions.slice(1).flatMap((position, i) => [...positions[i], ...position]);
}

/**
 * A pyramid whose tip is the camera, and whose base has the picture's shape.
 * @param {number[][]} T
 * @param {number[]} extents
 */
function frustum(T, [across, down]) {
  const point = (x, y, z) => [0, 1, 2].map((i) => T[i][0] * x + T[i][1] * y + T[i][2] * z + T[i][3]);
  const [w, tall, d] = [across * FRUSTUM, down * FRUSTUM, FRUSTUM];
  const tip = point(0, 0, 0);
  const corners = [point(-w, -tall, d), point(w, -tall, d), point(w, tall, d), point(-w, tall, d)];
  const above = point(0, -1.5 * tall, d);
  const edges = corners.flatMap((corner, i) => [...tip, ...corner, ...corner, ...corners[(i + 1) % 4]]);
  return [...edges, ...corners[0], ...above, ...above, ...corners[1]];
}

function quantiles(numbers, axis, shares, stride = STRIDE_LANDMARK) {
  const values = Float32Array.from({ length: numbers.length / stride }, (_, i) => numbers[i * stride + axis]).sort();
  return shares.map((share) => values[Math.round(share * (values.length - 1))] ?? 0);
}

/** A random order of so many. */
function shuffledOrder(count) {
  const order = Uint32Array.from({ length: count }, (_, i) => i);
  for (let i = count - 1; i > 0; i--) {
    const other = Math.floor(Math.random() * (i + 1));
    [order[i], order[other]] = [order[other], order[i]];
  }
  return order;
}

/** Rows of `stride` numbers in another order. */
function inOrder(numbers, stride, order) {
  const ordered = new numbers.constructor(numbers.length);
  order.forEach((row, i) => {
    ordered.set(numbers.subarray(row * stride, (row + 1) * stride), i * stride);
  });
  return ordered;
}

/** The view or landmark of which `distance(position)` is least, views first, if it is near enough; or null. */
function nearest({ landmarks, views }, distance) {
  const best = (numbers, stride) => {
    let [least, at] = [PICK_PX, -1];
    for (let i = 0; i < numbers.length; i += stride) {
      const apart = distance(numbers.subarray(i, i + 3));
      if (apart < least) [least, at] = [apart, i];
    }
    return at;
  };
  const view = best(views, STRIDE_VIEW);
  if (view >= 0)
    return {
      view: view / STRIDE_VIEW,
      position: [...views.subarray(view, view + 3)],
      heading: [...views.subarray(view + 3, view + 6)],
    };
  const landmark = best(landmarks, STRIDE_LANDMARK);
  if (landmark < 0) return null;
  return { position: [...landmarks.subarray(landmark, landmark + 3)], deviation: landmarks[landmark + 3] };
}

/**
 * What is said of something that was clicked.
 * @param {{view?: number, position: number[], heading?: number[], deviation?: number}} found
 * @param {boolean} metric
 */
export function sayPicked({ view, position, heading, deviation }, metric) {
  const at = position.map((value) => value.toFixed(2)).join(", ");
  const unit = metric ? "m" : t`units`;
  if (view === undefined) return t`Landmark at ${at} ${unit}, known to ${length(deviation, metric)}`;
  const degrees = Math.round((Math.atan2(heading[1], heading[0]) * 180) / Math.PI);
  return t`Picture ${view + 1} of the walk, from ${at} ${unit}, looking ${degrees}°`;
}

/** Three short lines through a point. */
function cross(position, reach) {
  return [0, 1, 2].flatMap((axis) =>
    [-reach, reach].flatMap((by) => position.map((value, i) => (i === axis ? value + by : value))),
  );
}

function upload(gl, numbers) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
  return buffer;
}

function program(gl, ...sources) {
  const made = gl.createProgram();
  sources.forEach((source, i) => {
    const shader = gl.createShader(i ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  });
  gl.bindAttribLocation(made, 0, "point");
  gl.bindAttribLocation(made, 1, "picture");
  gl.linkProgram(made);
  const bind = (buffer, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, size, gl.FLOAT, false, 0, 0);
  };
  const bindColours = (buffer) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 3, gl.UNSIGNED_BYTE, true, 0, 0);
  };
  const places = {};
  return { program: made, bind, bindColours, uniform: (name) => (places[name] ??= gl.getUniformLocation(made, name)) };
}

function resolved(element, token) {
  return resolvedColour(element, token)
    .match(/[\d.]+/g)
    .slice(0, 3)
    .map((part) => Number(part) / 255);
}
