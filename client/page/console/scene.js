// A map in 3-D: the room's surfaces, landmarks in the colours of the pictures or by uncertainty, more points on demand, the
// walk, waypoints, the map's axes, and the pose that was found. z is up; a map that is not upright is levelled for display.

import { multiply } from "../../js/poses.js";
import { resolvedColour } from "../shared/colours.js";
import { busy, fill, h } from "../shared/dom.js";
import { coordinates, t } from "../shared/text.js";
import { count, length } from "./format.js";
import { columns, fittingDistance, lookAt, perspective, project, rotation } from "./matrix.js";
import { painterOf } from "./painter.js";
import { planLines } from "./plan_lines.js";
import { presenceLines } from "./presence_lines.js";
import { errorAt } from "./rightness.js";
import { bestTurn, boundsOf, surfaces } from "./room.js";
import { inOrder, inOtherAxes, quantiles, SHOWN, shuffledOrder } from "./samples.js";
import { STRIDE_LANDMARK, STRIDE_VIEW } from "./scene_data.js";
import {
  apart,
  band,
  cross,
  ellipsoid,
  floor,
  floorOf,
  frustum,
  headings,
  outlines,
  secondViews,
  segments,
  squares,
  walk,
} from "./scene_lines.js";
import { Status } from "./track.js";

const FIELD_OF_VIEW = 0.9; // rad
const FRAMED = [0.05, 0.95]; // quantiles of landmarks along each axis that the whole room is made to hold
const MAX_TILT = 1.55; // rad, nearly straight down
const EXTENTS = [0.6, 0.45]; // of a camera of which nothing is known
const SMOOTH_MS = [20, 33]; // how far apart pictures may be while the map moves; fewer points are drawn, or more
const LEAST_DRAWN = 2000; // points, while the map moves
const REST_MS = 150; // after which a map that was moved rests, and all of it is drawn
const MIN_DISTANCE = 0.2; // map units
const MAX_RAYS = 150; // the most lines from the camera to landmarks
const POINT_SIZE = 0.025; // m, as wide as a point is drawn at least
const SPREAD = 0.4; // width of a point as a share of how far points would be apart in a plane: fewer are larger

const AXIS = 0.5; // m, of the axes at the origin
const PICK_PX = 14; // how near a click must be to its target
const KEY_PICK_PX = 120; // how near what a key picks must be to the middle
const FLOOR_THICK = 0.06; // of a room's height, within which surfaces are its floor
const CLICK_PX = 5; // how far a pointer may move in a click
/** @type {[string, number[], number[]][]} */
const AXES = [
  ["x", [1, 0, 0], [0.84, 0.2, 0.2]],
  ["y", [0, 1, 0], [0.15, 0.55, 0.2]],
  ["z", [0, 0, 1], [0.2, 0.4, 0.9]],
];
const HOME = { turn: -0.9, tilt: 0.6 }; // rad, where the whole room is looked at from
const RAMP = [
  [41, 120, 219],
  [168, 133, 168],
  [237, 125, 26],
]; // from certain to uncertain
const UNKNOWN = [128, 128, 128]; // what has no deviation, or no colour
const LEVEL = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
];

/** An element that shows a scene; `element` is put into a page, `show…` says what of, `dispose` ends it. */
export class SceneView {
  constructor(label) {
    this.canvas = h("canvas", {
      class: "scene-canvas",
      tabindex: 0,
      role: "img",
      "aria-label": t`${label}. Arrow keys turn, shift and arrow keys move, plus and minus zoom, Home resets, Enter picks what is in the middle.`,
    });
    this.labels = h("div", { class: "scene-labels", "aria-hidden": "true" });
    this.legend = h("div", { class: "scene-legend small", hidden: true });
    this.said = h("div", { class: "scene-said small", role: "status", hidden: true });
    this.levelled = h("p", { class: "scene-levelled small", hidden: true }, t`Levelled for display: up is estimated`);
    this.paint = h("button", { type: "button", hidden: true, onclick: () => this.switchColours() });
    this.more = h("button", { type: "button", hidden: true, onclick: () => busy(this.more, () => this.toggleCloud()) });
    this.solid = h(
      "button",
      { type: "button", hidden: true, "aria-pressed": "true", onclick: () => this.showSolid(!this.isSolid) },
      t`Surfaces`,
    );
    this.doubt = h(
      "button",
      { type: "button", hidden: true, "aria-pressed": "false", onclick: () => this.toggleErrors() },
      t`Expected error`,
    );
    this.twice = h(
      "button",
      { type: "button", hidden: true, "aria-pressed": "false", onclick: () => this.showTwice(!this.isTwice) },
      t`Both reconstructions`,
    );
    this.planned = h(
      "button",
      { type: "button", hidden: true, "aria-pressed": "true", onclick: () => this.togglePlan() },
      t`Floor plan`,
    );
    this.tools = h(
      "div",
      { class: "scene-tools" },
      h("button", { type: "button", onclick: () => this.lookDown() }, t`From above`),
      h("button", { type: "button", onclick: () => this.reset() }, t`Whole room`),
      this.solid,
      this.doubt,
      this.twice,
      this.paint,
      this.more,
      this.planned,
    );
    this.element = h(
      "div",
      { class: "scene" },
      this.canvas,
      this.labels,
      this.tools,
      this.levelled,
      this.said,
      this.legend,
    );
    this.styles = new Map(); // names of lines, and their colour and opacity
    this.colours = {};
    this.waypoints = [];
    this.robots = new Map(); // labels and positions, by asker
    this.coloured = false;
    this.levelling = LEVEL;
    this.count = this.budget = 0;
    this.room = null;
    this.home = HOME;
    this.cloud = null;
    this.pictureOf = null; // gives the address of a view's picture, where pictures are kept
    this.featureOf = null; // gives where a landmark may be seen from, and the views that saw it
    this.view = { target: [0, 0, 0], distance: 5, ...HOME };
    this.corners = [
      [-1, -1, -1],
      [1, 1, 1],
    ];
    this.pointSize = POINT_SIZE;
    this.painter = painterOf(this.canvas);
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
    listen(this);
  }

  dispose() {
    this.observer.disconnect();
    this.scheme.removeEventListener("change", this.recolour);
    cancelAnimationFrame(this.frame);
    clearTimeout(this.rest);
    this.painter.dispose();
  }

  /**
   * Show a map; `waypoints` as the service gives them, `metric` says whether lengths are metres; `levelling`, a rotation,
   * is given where z does not point up.
   */
  showMap(scene, waypoints, metric, names = { points: [], areas: [] }, levelling = null) {
    this.scene = scene;
    this.cloud = null;
    this.metric = metric;
    this.levelling = levelling ?? LEVEL;
    this.levelled.hidden = levelling === null;
    this.deviations = deviationsShown(scene.landmarks);
    const level = inOtherAxes(scene.landmarks, STRIDE_LANDMARK, this.levelling);
    const z = floorOf(level);
    this.floor = z;
    this.waypoints = waypoints.map(({ name, position, residual_m: residual }) => ({
      position,
      label: h("span", { class: "scene-waypoint" }, residual === null ? name : `${name} · ${length(residual, metric)}`),
    }));
    const tips = AXES.map(([name, axis]) => ({
      position: axis.map((value) => AXIS * value),
      label: h("span", { class: "scene-axis" }, name),
    }));
    this.waypoints.push(...tips, ...named(names, z));
    this.labels.replaceChildren(...this.waypoints.map(({ label }) => label));
    this.showRamp(t`uncertainty `, this.deviations);
    this.paint.hidden = !scene.colours;
    for (const [name, axis, colour] of AXES)
      this.setLines(`axis ${name}`, colour, [0, 0, 0, ...axis.map((value) => AXIS * value)]);
    this.setLines("floor", "--line", this.inMapAxes(floor(level)));
    this.setLines("areas", "--accent", outlines(names.areas, z));
    this.setLines("walk", "--ink", walk(scene.views));
    this.setLines("headings", "--muted", headings(scene.views));
    this.twice.hidden = !scene.second;
    this.colourBy(scene.colours !== null);
    this.lookAtAll(level, inOtherAxes(scene.views, STRIDE_VIEW, this.levelling));
  }

  /** Show a room (of `readRoom`) as surfaces, instead of landmarks. */
  showRoom(room) {
    this.room = surfaces(room, this.levelling);
    this.painter.setSurface(this.room.positions, this.room.tints, this.room.triangles);
    const bounds = boundsOf(this.room);
    this.floor = bounds[2][0];
    this.corners = cornersOf(bounds);
    this.home = { turn: bestTurn(this.room), tilt: HOME.tilt };
    this.setLines("floor", "--line", this.inMapAxes(squares(bounds)));
    this.solid.hidden = false;
    this.showSolid(true);
    this.reset();
  }

  /** Offer to tint the floor by the errors [m] that are expected of the views. */
  offerErrors(errors) {
    const known = errors.filter((error) => error !== null);
    this.errors = errors;
    this.errorEnds = [Math.min(...known), Math.max(...known)];
    this.doubt.hidden = !this.room || !known.length;
  }

  toggleErrors() {
    const shown = this.doubt.ariaPressed !== "true";
    this.doubt.ariaPressed = String(shown);
    const { positions, tints, triangles } = this.room;
    this.painter.setSurface(positions, shown ? this.floorByError() : tints, triangles);
    if (shown) this.showRamp(t`expected error `, this.errorEnds);
    this.legend.hidden = !shown;
    this.showSolid(true);
  }

  /** The room's tints, the floor's by the error that is expected there. */
  floorByError() {
    const { positions, level, tints } = this.room;
    const marked = tints.slice();
    const [low, high] = this.errorEnds;
    for (let i = 0; i < level.length; i += 3) {
      if (level[i + 2] > this.floor + FLOOR_THICK * (this.corners[7][2] - this.floor)) continue;
      const error = errorAt(this.scene.views, this.errors, positions[i], positions[i + 1]);
      if (error !== null) marked.set(ramp((error - low) / Math.max(high - low, 1e-9)), i);
    }
    return marked;
  }

  get isTwice() {
    return this.twice.ariaPressed === "true";
  }

  /** Draw the walk as a second reconstruction has it, in another colour, and how far apart the two are. */
  showTwice(shown) {
    const { views, second } = this.scene;
    this.twice.ariaPressed = String(shown);
    this.setLines("second walk", "--warn", shown ? walk(secondViews(views, second)) : []);
    this.setLines("apart", "--bad", shown ? apart(views, second) : [], 0.6);
    this.legend.hidden = !shown;
    this.legend.replaceChildren(
      h("span", { class: "scene-walk" }),
      t`the walk in this map`,
      h("span", { class: "scene-second" }),
      t`in a second reconstruction: where they drift apart, the map may be wrong`,
    );
  }

  /** Say what the ramp of colours goes from and to. */
  showRamp(called, ends) {
    this.legend.replaceChildren(
      called,
      h("span", { class: "mono" }, length(ends[0], this.metric)),
      h("span", { class: "scene-ramp" }),
      h("span", { class: "mono" }, length(ends[1], this.metric)),
    );
  }

  /** Mark a view by its number, as if it had been clicked. */
  showView(view) {
    this.showPicked(viewAt(this.scene.views, view));
  }

  /** Draw the room's surfaces, or landmarks. */
  showSolid(solid) {
    this.solid.ariaPressed = String(solid);
    this.redraw();
  }

  get isSolid() {
    return this.room !== null && this.solid.ariaPressed === "true";
  }

  /** Lines in level axes as the map's own frame has them. */
  inMapAxes(lines) {
    return inOtherAxes(lines, 3, transposed(this.levelling));
  }

  /** Draw a floor plan, as `keptPlan` gives it, on the floor. */
  showPlan(plan) {
    this.plan = planLines(plan, this.floor);
    this.planned.hidden = false;
    this.setLines("plan", "--muted", this.plan);
  }

  togglePlan() {
    const shown = this.planned.ariaPressed !== "true";
    this.planned.ariaPressed = String(shown);
    this.setLines("plan", "--muted", shown ? this.plan : []);
  }

  /** Offer so many further points of the room; `load` fetches them when they are asked for, `{positions, colours}`. */
  offerCloud(points, load) {
    this.more.hidden = !points;
    this.loadCloud = load;
    this.more.textContent = t`Show ${count(points)} more points`;
    this.less = t`Landmarks only`;
    this.most = this.more.textContent;
  }

  async toggleCloud() {
    this.cloud = this.cloud ? null : await this.loadCloud();
    this.more.textContent = this.cloud ? this.less : this.most;
    this.showSolid(false);
    this.setPoints();
  }

  /** Hand all points to the painter, in a random order, so that the first of them are a fair sample. */
  setPoints() {
    const { landmarks, colours } = this.scene;
    const tints = this.coloured ? colours : certainties(landmarks, this.deviations);
    const positions = inOtherAxes(landmarks, STRIDE_LANDMARK, LEVEL, 3);
    const extra = this.cloud && (this.coloured ? this.cloud.colours : plain(this.cloud.colours.length));
    const [all, allTints] = this.cloud
      ? [joined(positions, this.cloud.positions), joined(tints, extra)]
      : [positions, tints];
    this.count = this.budget = all.length / 3;
    const order = shuffledOrder(this.count);
    this.painter.setPoints(inOrder(all, 3, order), inOrder(allTints, 3, order));
    this.redraw();
  }

  switchColours() {
    if (this.doubt.ariaPressed === "true") this.toggleErrors();
    this.showRamp(t`uncertainty `, this.deviations);
    this.colourBy(!this.coloured);
    this.showSolid(false);
  }

  /** Paint landmarks in the colours of the pictures, or by how uncertain they are. */
  colourBy(pictures) {
    this.coloured = pictures;
    this.paint.textContent = pictures ? t`Colour by uncertainty` : t`Colours of the pictures`;
    this.legend.hidden = pictures || !this.scene?.features;
    this.setPoints();
  }

  /** Look straight down on the whole of it, north up. */
  lookDown() {
    this.showWhole({ turn: -Math.PI / 2, tilt: MAX_TILT });
  }

  /** Say what is within so many pixels of a place of the canvas, and mark it. */
  pick(x, y, reach = PICK_PX) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const matrix = this.matrix(width / height);
    const found = nearest(
      this.scene,
      (point) => {
        const [px, py, w] = project(matrix, point);
        return w <= 0 ? Infinity : Math.hypot(((px + 1) / 2) * width - x, ((1 - py) / 2) * height - y);
      },
      reach,
    );
    this.showPicked(found);
  }

  /** Mark what was picked and say what it is; of a view with the ways to the next ones, and its picture if it is kept. */
  showPicked(found) {
    this.said.hidden = !found;
    this.picked = found;
    this.setLines("picked", "--accent", found ? cross(found.position, AXIS / 4) : []);
    this.setLines("presence", "--accent", []);
    this.setLines("sightings", "--muted", []);
    if (!found) return;
    const views = this.scene.views.length / STRIDE_VIEW;
    const step = (by, text) =>
      h(
        "button",
        {
          type: "button",
          "aria-label": text,
          onclick: () => {
            this.showPicked(viewAt(this.scene.views, (found.view + by + views) % views));
            this.said.querySelectorAll("button")[by < 0 ? 0 : 1].focus();
          },
        },
        by < 0 ? "‹" : "›",
      );
    const isView = found.view !== undefined;
    const picture = h("img", { alt: "", hidden: true });
    fill(
      this.said,
      picture,
      h(
        "div",
        { class: "row" },
        h("span", {}, sayPicked(found, this.metric)),
        isView && views > 1 && [step(-1, t`Picture before`), step(1, t`Next picture`)],
      ),
    );
    if (isView && this.pictureOf) this.showPicture(picture, found.view);
    if (!isView && this.featureOf) this.showPresence(found);
  }

  /** Show where a landmark that was picked may be seen from, and which views saw it. */
  async showPresence(found) {
    try {
      const feature = await this.featureOf(found.landmark);
      if (this.picked !== found) return;
      const at = (view) => this.scene.views.subarray(view * STRIDE_VIEW, view * STRIDE_VIEW + 3);
      this.setLines("presence", "--accent", presenceLines(feature), 0.45);
      const sightings = feature.views.flatMap((view) => [...feature.position, ...at(view)]);
      this.setLines("sightings", "--muted", sightings, 0.6);
      this.said.append(h("p", {}, t`Seen in ${feature.views.length} pictures; it is looked for within the cone.`));
    } catch {
      // gone meanwhile, or of a map that does not remember who saw what: the landmark itself is marked
    }
  }

  async showPicture(image, view) {
    try {
      image.src = await this.pictureOf(view);
      await image.decode();
      URL.revokeObjectURL(image.src);
      image.alt = t`What the camera saw there`;
      image.hidden = false;
    } catch {
      image.remove(); // no picture is kept of this view
    }
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

  /** Show those who ask for poses: `{asker, T, stale}`. */
  showRobots(robots) {
    const some = (chosen) => robots.filter(chosen).flatMap(({ T }) => frustum(T, EXTENTS));
    this.setLines(
      "robots",
      "--accent",
      some(({ stale }) => !stale),
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

  /** Show a track (`Track`), or none: its way, where it was lost, and ellipsoids of two standard deviations along it. */
  showTrack(track) {
    const { pieces = [], marks = [], now } = track ?? {};
    const ways = (lost) =>
      pieces.filter(({ status }) => (status === Status.LOST) === lost).flatMap(({ positions }) => band(positions));
    this.setLines("track", "--warn", ways(false));
    this.setLines("track lost", "--bad", ways(true));
    this.setLines("spread", "--warn", marks.flatMap(ellipsoid), 0.5);
    this.setLines("spread now", "--accent", now?.pose ? ellipsoid({ ...now, position: now.pose.position }) : []);
  }

  setLines(name, token, vertices, alpha = 1) {
    this.styles.set(name, { token, alpha });
    this.painter.setLines(name, Float32Array.from(vertices));
    this.redraw();
  }

  /** Look at all of these landmarks and views, in axes with z up. */
  lookAtAll(landmarks, views) {
    const spans = [0, 1, 2].map((axis) => {
      const ends = views.length ? quantiles(views, axis, [0, 1], STRIDE_VIEW) : [];
      if (landmarks.length) ends.push(...quantiles(landmarks, axis, FRAMED));
      return ends.length ? [Math.min(...ends), Math.max(...ends)] : [-1, 1];
    });
    this.corners = cornersOf(spans);
    this.pointSize = Math.max(POINT_SIZE, (SPREAD * diagonal(spans)) / Math.sqrt(landmarks.length / STRIDE_LANDMARK));
    this.reset();
  }

  reset() {
    this.showWhole(this.home);
  }

  /** Look at the whole room from a direction, from as near as its bulk fills the picture. */
  showWhole({ turn, tilt }) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const aspect = width / height || 1;
    const target = [0, 1, 2].map((axis) => (this.corners[0][axis] + this.corners.at(-1)[axis]) / 2);
    const fitting = fittingDistance(this.corners, target, backwards(turn, tilt), fieldOfView(aspect), aspect);
    this.view = { target, distance: Math.max(MIN_DISTANCE, fitting), turn, tilt };
    this.redraw();
  }

  turn(by, tilt) {
    this.view.turn += by;
    this.view.tilt = Math.min(MAX_TILT, Math.max(-MAX_TILT, this.view.tilt + tilt));
    this.move();
  }

  zoom(factor) {
    this.view.distance = Math.min(500, Math.max(MIN_DISTANCE, this.view.distance * factor));
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

  /** Draw while the user moves the map: as many points as keep it smooth, and all of them once it rests. */
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

  /** Whether picture follows picture: then no more points are drawn than keep it smooth. */
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
    const { canvas } = this;
    const ratio = Math.min(devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((value) =>
      Math.max(1, Math.round(value * ratio)),
    );
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const matrix = this.matrix(width / height);
    this.painter.paint({
      matrix: columns(matrix),
      background: this.colour("--surface"),
      surface: this.isSolid,
      count: this.isSolid ? 0 : this.restless ? this.budget : this.count,
      size: this.pointSize * height,
      styles: [...this.styles]
        .filter(([name]) => !(this.isSolid && name === "headings"))
        .map(([name, { token, alpha }]) => [name, [...this.colour(token), alpha]]),
    });
    this.placeLabels(matrix);
  }

  /** A colour of the design, or one given as three numbers, from 0 to 1. */
  colour(token) {
    if (Array.isArray(token)) return token;
    return (this.colours[token] ??= resolved(this.canvas, token));
  }

  /** Put labels where they belong; of those that would lie on each other only the first is written. */
  placeLabels(matrix) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const written = [];
    for (const named of [...this.robots.values(), ...this.waypoints]) {
      const { position, label } = named;
      const [x, y, w] = project(matrix, position);
      const [left, top] = [((x + 1) / 2) * width, ((1 - y) / 2) * height];
      label.style.transform = `translate(${left}px, ${top}px)`;
      label.hidden = w <= 0 || Math.abs(x) > 1 || Math.abs(y) > 1;
      if (label.hidden) continue;
      named.size ??= [label.offsetWidth, label.offsetHeight];
      const box = [left, top, left + named.size[0], top + named.size[1]];
      const crowded = written.some((other) => overlap(box, other));
      label.classList.toggle("crowded", crowded);
      if (!crowded) written.push(box);
    }
  }

  matrix(aspect) {
    const { target, distance, turn, tilt } = this.view;
    const away = backwards(turn, tilt);
    const eye = target.map((value, i) => value + distance * away[i]);
    const fov = fieldOfView(aspect);
    const level = multiply(lookAt(eye, target), rotation(this.levelling));
    return multiply(perspective(fov, aspect, distance / 100, distance * 20), level);
  }
}

/** Unit vector from what is looked at to the eye. */
const backwards = (turn, tilt) => [Math.cos(turn) * Math.cos(tilt), Math.sin(turn) * Math.cos(tilt), Math.sin(tilt)];

/** Height of the picture [rad]; in a picture that stands, its width is the usual one. */
const fieldOfView = (aspect) => (aspect < 1 ? 2 * Math.atan(Math.tan(FIELD_OF_VIEW / 2) / aspect) : FIELD_OF_VIEW);

/** The corners of a box with these ends along each axis. */
const cornersOf = (spans) => Array.from({ length: 8 }, (_, i) => spans.map((span, axis) => span[(i >> axis) & 1]));

const diagonal = (spans) => Math.hypot(...spans.map(([low, high]) => high - low));

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
    else if (event.key === "Enter" && scene.scene)
      scene.pick(canvas.clientWidth / 2, canvas.clientHeight / 2, KEY_PICK_PX);
    else return;
    event.preventDefault();
  });
}

const overlap = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

/** What is nearest by a distance in pixels, if it is within reach; a view rather than a landmark behind it. */
function nearest({ landmarks, views }, distance, reach) {
  const best = (numbers, stride) => {
    let [least, at] = [reach, -1];
    for (let i = 0; i < numbers.length; i += stride) {
      const apart = distance(numbers.subarray(i, i + 3));
      if (apart < least) [least, at] = [apart, i];
    }
    return { apart: least, at };
  };
  const view = best(views, STRIDE_VIEW);
  const landmark = best(landmarks, STRIDE_LANDMARK);
  if (view.at >= 0 && view.apart <= landmark.apart + PICK_PX) return viewAt(views, view.at / STRIDE_VIEW);
  if (landmark.at < 0) return null;
  return {
    landmark: landmark.at / STRIDE_LANDMARK,
    position: [...landmarks.subarray(landmark.at, landmark.at + 3)],
    deviation: landmarks[landmark.at + 3],
  };
}

/** A view by its number, as it is picked. */
function viewAt(views, view) {
  const [at, end] = [view * STRIDE_VIEW, (view + 1) * STRIDE_VIEW];
  return { view, position: [...views.subarray(at, at + 3)], heading: [...views.subarray(at + 3, end - 1)] };
}

/**
 * What is said of something that was clicked.
 * @param {{view?: number, position: number[], heading?: number[], deviation?: number}} found
 * @param {boolean} metric
 */
export function sayPicked({ view, position, heading, deviation }, metric) {
  const at = coordinates(position);
  const unit = metric ? "m" : t`units`;
  if (view === undefined) return t`Landmark at ${at} ${unit}, known to ${length(deviation, metric)}`;
  const degrees = (Math.round((Math.atan2(heading[1], heading[0]) * 180) / Math.PI) + 360) % 360;
  return t`Picture ${view + 1} of the walk, from ${at} ${unit}, looking ${degrees}°`;
}

/** Labels of named points and areas, these in the middle of their floor. */
export function named({ points, areas }, z) {
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

/** Deviations from which to which the colours tell. */
function deviationsShown(landmarks) {
  return quantiles(landmarks, 3, SHOWN).map((value) => Math.max(value, 1e-4));
}

/** A colour (N, 3) of each landmark, by how uncertain it is, on a logarithmic scale. */
function certainties(landmarks, deviations) {
  const [least, most] = deviations.map(Math.log);
  const tints = new Uint8Array((3 * landmarks.length) / STRIDE_LANDMARK);
  for (let i = 0; i < tints.length / 3; i++) {
    const share = (Math.log(landmarks[STRIDE_LANDMARK * i + 3]) - least) / Math.max(most - least, 0.1);
    tints.set(ramp(share), 3 * i);
  }
  return tints;
}

/** The colour of a share of the ramp, from certain (0) to uncertain (1). */
function ramp(share) {
  const along = (RAMP.length - 1) * Math.min(1, Math.max(0, share || 0));
  const from = Math.min(RAMP.length - 2, Math.floor(along));
  return RAMP[from].map((value, c) => value + (along - from) * (RAMP[from + 1][c] - value));
}

/** As many numbers of a colour that says nothing. */
const plain = (numbers) => Uint8Array.from({ length: numbers }, (_, i) => UNKNOWN[i % 3]);

function joined(a, b) {
  const both = new a.constructor(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}

const transposed = (R) => R.map((_, i) => R.map((row) => row[i]));

function resolved(element, token) {
  return resolvedColour(element, token)
    .match(/[\d.]+/g)
    .slice(0, 3)
    .map((part) => Number(part) / 255);
}
