// A map made right: its frame, its scale, what is to go and what is called what, drawn on the map or typed.

import { download, path, rholoc } from "../shared/api.js";
import { action, fill, h, tell } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { GEOJSON, planUnder } from "./floor_plan.js";
import { count, length, when } from "./format.js";
import { loading, page, skeletons } from "./parts.js";
import { PlanPicture } from "./plan_picture.js";
import { PlanView, Side } from "./plan_view.js";
import { readScene } from "./scene_data.js";

const DIGITS = 3; // of coordinates that are shown
const SIDES = [
  [Side.ABOVE, t`From above`],
  [Side.SOUTH, t`From the south`],
  [Side.EAST, t`From the east`],
];

/** What is drawn for a correction. */
const Shape = Object.freeze({
  POINT: "point",
  LINE: "line",
  POLYGON: "polygon",
  PIECE: "piece",
  PLAN: "plan",
  NONE: "",
});

const NAMED_LABELS = { name: t`Name`, kind: t`Kind`, fields: t`More: name=value, …` };
const namedInputs = () => ({
  name: h("input", { maxlength: 100, required: true, autocomplete: "off" }),
  kind: h("input", { maxlength: 100, autocomplete: "off", placeholder: t`room, door, charger` }),
  fields: h("input", { autocomplete: "off", placeholder: "seats=12, owner=Ada" }),
});

/** Each correction: what it is called, what to do, what is drawn, from where, and what is sent. */
const TOOLS = [
  {
    kind: "origin",
    text: t`Origin`,
    hint: t`Click the point that is to be (0, 0), or type it. From a side, its height.`,
    shape: Shape.POINT,
    body: ({ point }) => ({ at: point }),
  },
  {
    kind: "wall",
    text: t`Axis along a wall`,
    hint: t`Drag along a wall: x will point that way.`,
    shape: Shape.LINE,
    body: ({ line }) => ({ direction: difference(line) }),
  },
  {
    kind: "north",
    text: t`North`,
    hint: t`Drag towards the north: y will point that way.`,
    shape: Shape.LINE,
    body: ({ line }) => ({ direction: difference(line) }),
  },
  {
    kind: "up",
    text: t`Upright`,
    hint: t`From a side, drag upwards along something vertical, such as the edge of a door. Then the same from the other side.`,
    shape: Shape.LINE,
    side: Side.SOUTH,
    body: ({ line, view }) => ({ direction: upward(line, view.side) }),
  },
  {
    kind: "level",
    text: t`Level by the pictures`,
    hint: t`Estimates what is up from how the camera was held: to a few degrees.`,
    shape: Shape.NONE,
    body: () => ({ kind: "up" }),
  },
  {
    kind: "scale",
    text: t`Distance`,
    hint: t`Drag from one end of something measured to the other, and type its true length.`,
    shape: Shape.LINE,
    inputs: () => ({ length_m: number({ min: 0.001, required: true }) }),
    labels: { length_m: t`True length, m` },
    body: ({ line, inputs }) => ({ start: line[0], end: line[1], length_m: inputs.length_m.valueAsNumber }),
  },
  {
    kind: "plan",
    text: t`Floor plan`,
    hint: t`Open a plan, then click a point of the map and the same point of the plan, twice.`,
    shape: Shape.PLAN,
    body: (editor) => editor.planBody(),
  },
  {
    kind: "region",
    text: t`Crop or delete a region`,
    hint: t`Drag a rectangle, or click corner after corner.`,
    shape: Shape.POLYGON,
    inputs: () => ({
      keep: h(
        "select",
        {},
        h("option", { value: "outside" }, t`delete what is inside`),
        h("option", { value: "inside" }, t`keep only what is inside`),
      ),
      bottom_m: number(),
      top_m: number(),
    }),
    labels: { keep: t`Do`, bottom_m: t`Only above z =`, top_m: t`Only below z =` },
    body: ({ polygon, inputs }) => ({
      outline: polygon.map((corner) => corner.slice(0, 2)),
      keep: inputs.keep.value,
      bottom_m: optional(inputs.bottom_m),
      top_m: optional(inputs.top_m),
    }),
  },
  {
    kind: "walk",
    text: t`Delete a piece of the walk`,
    hint: t`Drag along the piece of the walk that is to go.`,
    shape: Shape.PIECE,
    body: ({ piece }) => ({ first_view: piece[0], last_view: piece[1] }),
  },
  {
    kind: "point",
    text: t`Name a point`,
    hint: t`Click the point, and type its name.`,
    shape: Shape.POINT,
    inputs: namedInputs,
    labels: NAMED_LABELS,
    body: ({ map, point, inputs }) => withNamed(map.names, "points", inputs, { position: point }),
  },
  {
    kind: "area",
    text: t`Name an area`,
    hint: t`Drag a rectangle, or click corner after corner, and type its name.`,
    shape: Shape.POLYGON,
    inputs: namedInputs,
    labels: NAMED_LABELS,
    body: ({ map, polygon, inputs }) =>
      withNamed(map.names, "areas", inputs, { outline: polygon.map((corner) => corner.slice(0, 2)) }),
  },
];

const KINDS = {
  origin: t`origin`,
  north: t`north`,
  wall: t`axis along a wall`,
  up: t`upright`,
  scale: t`scale`,
  plan: t`laid over a plan`,
  region: t`region removed`,
  walk: t`piece of the walk removed`,
  names: t`names`,
  "floor-plan": t`floor plan`,
  earth: t`place on Earth`,
  labels: t`site, floor, tags`,
};

export async function showCorrections(main, name, signal, chosen = TOOLS[0].kind) {
  const place = h("div", {}, skeletons(1, "panel"));
  const back = h("a", { class: "button", href: `#/maps/${encodeURIComponent(name)}` }, t`To the map`);
  fill(main, page(t`Make ${name} right`, back, place));
  const editor = new Editor(name, signal);
  signal.addEventListener("abort", () => editor.view.dispose());
  await loading(
    place,
    async () => {
      await editor.load();
      fill(place, editor.element);
      editor.look(Side.ABOVE);
      editor.tools.value = chosen;
      editor.choose(TOOLS[editor.tools.selectedIndex]);
    },
    signal,
  );
}

/** Corrections of a map, with the correction chosen that names a point. */
export const showNaming = (main, name, signal) => showCorrections(main, name, signal, "point");

class Editor {
  constructor(name, signal) {
    this.name = name;
    this.signal = signal;
    this.view = new PlanView(
      t`The map ${name}, to draw on. Arrow keys move, plus and minus zoom, Home shows all of it.`,
      {
        drawn: (points, done) => this.drawn(points, done),
        clicked: (point) => this.clicked(point),
      },
    );
    this.plan = new PlanPicture((point) => this.pinPlan(point));
    this.sides = SIDES.map(([side, text]) =>
      h("button", { type: "button", "aria-pressed": side === this.view.side, onclick: () => this.look(side) }, text),
    );
    this.tools = h(
      "select",
      { name: "tool", onchange: () => this.choose(TOOLS[this.tools.selectedIndex]) },
      TOOLS.map(({ kind, text }) => h("option", { value: kind }, text)),
    );
    this.hint = h("p", { class: "small muted" });
    this.fields = h("div", { class: "form" });
    this.said = h("p", { class: "small", role: "status" });
    this.apply = h("button", { class: "primary" }, t`Apply`);
    this.form = h(
      "form",
      { class: "card stack", onsubmit: (event) => this.send(event) },
      field(t`What is to be corrected?`, this.tools),
      this.hint,
      this.fields,
      this.said,
      h("div", { class: "row" }, this.apply, h("button", { type: "button", onclick: () => this.clear() }, t`Clear`)),
    );
    this.history = h("section", { class: "card stack" });
    this.named = h("section", { class: "card stack" });
    this.element = h(
      "div",
      { class: "map-columns" },
      h("div", { class: "stack" }, h("div", { class: "row" }, this.sides), this.view.canvas, this.plan.element),
      h("div", { class: "stack" }, this.form, this.named, this.history),
    );
  }

  /** The map as it is now. */
  async load() {
    const { signal } = this;
    const address = path`v1/maps/${this.name}`;
    const [map, { versions }, scene] = await Promise.all([
      rholoc.get(address, { signal }),
      rholoc.get(`${address}/versions`, { signal }),
      rholoc.bytes(`${address}/scene`, { signal }),
    ]);
    this.map = map;
    this.metric = map.scale === "metric";
    this.kept = await planUnder(map, signal);
    this.view.unit = this.metric ? "m" : t`units`;
    this.view.show(readScene(scene), map.names, map.waypoints);
    this.showHistory(versions);
    this.showNames();
  }

  choose(tool) {
    this.tool = tool;
    this.hint.textContent = tool.hint;
    this.inputs = tool.inputs?.() ?? {};
    this.plan.element.hidden = tool.shape !== Shape.PLAN;
    if (tool.side ? this.view.side === Side.ABOVE : tool.shape !== Shape.POINT && tool.kind !== "scale")
      this.look(tool.side ?? Side.ABOVE);
    this.clear();
  }

  look(side) {
    this.view.look(side);
    SIDES.forEach(([one], i) => {
      this.sides[i].setAttribute("aria-pressed", String(one === side));
    });
  }

  /** Nothing is drawn yet. */
  clear() {
    Object.assign(this, { point: [0, 0, 0], line: null, polygon: [], piece: null, pins: [], planPins: [] });
    this.plan.pin([]);
    this.showFields();
    this.show();
  }

  drawn([from, to], _done) {
    const { shape } = this.tool;
    if (shape === Shape.POINT) this.point = this.onlySeen(this.point, to);
    if (shape === Shape.LINE) this.line = [from, to];
    if (shape === Shape.POLYGON) this.polygon = rectangle(from, to);
    if (shape === Shape.PIECE) this.piece = [from, to].map((one) => this.view.nearestView(one)).sort((a, b) => a - b);
    this.showFields();
    this.show();
  }

  clicked(point) {
    const { shape } = this.tool;
    if (shape === Shape.POINT) this.point = this.onlySeen(this.point, point);
    if (shape === Shape.POLYGON) this.polygon = [...this.polygon, point];
    if (shape === Shape.PIECE) {
      const view = this.view.nearestView(point);
      this.piece = [this.piece?.[0] ?? view, view].sort((a, b) => a - b);
    }
    if (shape === Shape.PLAN) this.pins = [...this.pins, point].slice(-2);
    this.showFields();
    this.show();
  }

  pinPlan(point) {
    this.planPins = [...this.planPins, point].slice(-2);
    this.plan.pin(this.planPins);
    this.show();
  }

  /** A point with those coordinates of another that are seen from here. */
  onlySeen(before, point) {
    const { right, up } = this.view.side;
    return before.map((value, i) => (right[i] || up[i] ? point[i] : value));
  }

  show() {
    const { shape } = this.tool;
    const { point, line, polygon, piece, pins } = this;
    const plan = shape === Shape.PLAN && this.complete() ? this.plan.placed(pins, this.planPins) : this.kept;
    if (shape === Shape.PLAN) this.view.set({ pins, plan });
    else if (shape === Shape.POINT) this.view.set({ point, plan });
    else this.view.set({ line: shape === Shape.LINE ? line : null, polygon, piece, plan });
    this.said.textContent = this.say();
    this.apply.disabled = !this.complete();
  }

  complete() {
    return {
      [Shape.POINT]: () => this.point.every(Number.isFinite),
      [Shape.LINE]: () => this.line && Math.hypot(...difference(this.line)) > 0,
      [Shape.POLYGON]: () => this.polygon.length > 2,
      [Shape.PIECE]: () => this.piece !== null,
      [Shape.PLAN]: () => this.plan.size !== null && this.pins.length === 2 && this.planPins.length === 2,
      [Shape.NONE]: () => true,
    }[this.tool.shape]();
  }

  /** What is said of what is drawn. */
  say() {
    if (this.tool.shape === Shape.LINE && this.line) {
      const [dx, dy, dz] = difference(this.line);
      return t`${length(Math.hypot(dx, dy, dz), this.metric)} on the map`;
    }
    if (this.tool.shape === Shape.POLYGON && this.polygon.length > 2) {
      const { landmarks } = this.view.scene;
      const inside = countInside(landmarks, this.polygon);
      return t`${count(inside)} of ${count(landmarks.length / 4)} landmarks inside`;
    }
    if (this.tool.shape === Shape.PIECE && this.piece)
      return t`Pictures ${this.piece[0] + 1} to ${this.piece[1] + 1} of ${count(this.map.views)}`;
    if (this.tool.shape === Shape.PLAN) return this.sayPlan();
    return "";
  }

  sayPlan() {
    if (!this.complete()) return "";
    const onMap = Math.hypot(...difference(this.pins).slice(0, 2));
    const onPlan = this.plan.perPixel(this.pins, this.planPins) * Math.hypot(...difference(this.planPins));
    const off = Math.abs(onMap - onPlan);
    return t`A to B: ${length(onMap, this.metric)} on the map, ${length(onPlan)} on the plan; each point is off by ${length(off / 2)} unless the map is scaled.`;
  }

  planBody() {
    const perPixel = this.plan.perPixel(this.pins, this.planPins);
    const points = this.pins.map((map, i) => ({ map, plan: this.planPins[i].map((value) => value * perPixel) }));
    return { points, scaled: this.plan.scaled };
  }

  /** The figures of what is drawn, which may be typed as well. */
  showFields() {
    const { shape, labels = {} } = this.tool;
    const extras = Object.entries(this.inputs).map(([name, input]) => field(labels[name], input));
    const own = {
      [Shape.POINT]: () => this.coordinates("point", this.point, (point) => (this.point = point)),
      [Shape.LINE]: () => {
        const [from, to] = this.line ?? [this.point, this.point];
        return [
          this.coordinates(t`from`, from, (point) => (this.line = [point, this.line?.[1] ?? to])),
          this.coordinates(t`to`, to, (point) => (this.line = [this.line?.[0] ?? from, point])),
        ];
      },
      [Shape.POLYGON]: () => this.corners(),
      [Shape.PIECE]: () => this.ends(),
      [Shape.PLAN]: () => this.plan.fields(this.metric, () => this.show()),
    }[shape];
    fill(this.fields, own?.(), extras);
  }

  coordinates(text, point, changed) {
    const inputs = point.map((value) => number({ value: shown(value) }));
    for (const input of inputs) {
      input.addEventListener("input", () => {
        changed(inputs.map((one) => one.valueAsNumber || 0));
        this.show();
      });
    }
    const what = text === "point" ? "" : `${text} `;
    return h(
      "div",
      { class: "row coordinates" },
      inputs.map((input, i) => field(`${what}${"xyz"[i]}`, input)),
    );
  }

  corners() {
    const input = h("input", {
      value: this.polygon.map((corner) => corner.slice(0, 2).map(shown).join(" ")).join(", "),
      placeholder: "0 0, 4 0, 4 3",
      autocomplete: "off",
    });
    input.addEventListener("input", () => {
      const corners = input.value.split(",").map((corner) => corner.trim().split(/\s+/).map(Number));
      const valid = corners.every((corner) => corner.length === 2 && corner.every(Number.isFinite));
      this.polygon = valid ? corners.map((corner) => [...corner, 0]) : [];
      this.show();
    });
    return field(t`Corners: x y, x y, …`, input);
  }

  ends() {
    const most = this.map.views;
    const inputs = [0, 1].map((i) =>
      number({ min: 1, max: most, step: 1, value: this.piece ? this.piece[i] + 1 : "" }),
    );
    for (const input of inputs) {
      input.addEventListener("input", () => {
        const ends = inputs.map((one) => Math.min(most, Math.max(1, one.valueAsNumber)) - 1);
        this.piece = ends.every(Number.isFinite) ? ends.sort((a, b) => a - b) : null;
        this.show();
      });
    }
    return [t`First picture`, t`Last picture`].map((text, i) => field(text, inputs[i]));
  }

  async send(event) {
    event.preventDefault();
    await this.correct({ kind: this.tool.kind, ...this.tool.body(this) });
  }

  async correct(body) {
    this.apply.disabled = true;
    try {
      const wanted = { ...body, version: this.map.version };
      await rholoc.call("POST", path`v1/maps/${this.name}/corrections`, { body: wanted, signal: this.signal });
      if (body.kind === "plan") await this.keepPlan();
      tell(t`Done. The version before can be restored.`);
      await this.load();
      this.clear();
    } catch (error) {
      if (!this.signal.aborted) tell(error.message, "bad");
    } finally {
      this.apply.disabled = !this.complete();
    }
  }

  /** Keep the plan with the map, whose frame is the plan's by now. */
  async keepPlan() {
    const { body, unit } = await this.plan.content();
    const query = { m_per_unit: unit * this.plan.perPixel(this.pins, this.planPins) };
    const headers = { "Content-Type": body.type };
    await rholoc.call("PUT", path`v1/maps/${this.name}/plan`, { query, headers, body, signal: this.signal });
  }

  async forgetPlan() {
    await rholoc.call("DELETE", path`v1/maps/${this.name}/plan`, { signal: this.signal });
    tell(t`Done. The version before can be restored.`);
    await this.load();
    this.clear();
  }

  showNames() {
    const { points, areas } = this.map.names;
    const remove = (kind, name) =>
      this.correct({ kind: "names", ...this.map.names, [kind]: others(this.map.names[kind], name) });
    const about = ({ kind, fields }) =>
      [kind, ...Object.entries(fields).map(([key, value]) => `${key}: ${value}`)].filter(Boolean).join(", ");
    const item = (kind, what, name) =>
      h(
        "li",
        { class: "row spread" },
        h("span", {}, name, " ", h("span", { class: "muted small" }, what)),
        action(t`Delete`, () => remove(kind, name), "danger"),
      );
    fill(
      this.named,
      h("h2", {}, t`Names`),
      h(
        "ul",
        { class: "plain" },
        points.map((one) => item("points", about(one) || t`point`, one.name)),
        areas.map((one) => item("areas", about(one) || t`area`, one.name)),
        this.kept &&
          h(
            "li",
            { class: "row spread" },
            h("span", { class: "muted" }, t`Floor plan`),
            action(t`Remove the plan`, () => this.forgetPlan(), "danger"),
          ),
      ),
      h(
        "div",
        { class: "row" },
        action(t`Save names as GeoJSON`, () =>
          download(path`v1/maps/${this.name}/names`, `${this.name}.geojson`, { signal: this.signal }),
        ),
      ),
      this.fromFile(),
    );
  }

  /** Names or a floor plan from a file that says where they lie. */
  fromFile() {
    const what = h(
      "select",
      {},
      h("option", { value: "names" }, t`names`),
      h("option", { value: "plan" }, t`floor plan`),
    );
    const file = h("input", { type: "file", accept: ".json,.geojson,.zip", required: true });
    const level = h("input", { maxlength: 100, autocomplete: "off" });
    const open = async (event) => {
      event.preventDefault();
      const [body] = file.files;
      const headers = { "Content-Type": /\.zip$/i.test(body.name) ? "application/zip" : GEOJSON };
      const query = { level: level.value.trim() };
      try {
        await rholoc.call("PUT", `${path`v1/maps/${this.name}/`}${what.value}`, {
          query,
          headers,
          body,
          signal: this.signal,
        });
        tell(t`Done. The version before can be restored.`);
        await this.load();
        this.clear();
      } catch (error) {
        if (!this.signal.aborted) tell(error.message, "bad");
      }
    };
    return h(
      "details",
      {},
      h("summary", { class: "small" }, t`Open a file`),
      h(
        "form",
        { class: "stack", onsubmit: open },
        field(t`What the file has`, what),
        field(t`File`, file, t`GeoJSON, an IMDF archive, or a ZIP file with the yaml and picture of a map_server.`),
        field(t`Level of an IMDF archive`, level),
        h("button", {}, t`Open`),
      ),
    );
  }

  showHistory(versions) {
    const done = this.map.corrections.toReversed();
    const restore = async ({ number: which }) => {
      await rholoc.call("POST", path`v1/maps/${this.name}/restore`, { query: { number: which }, signal: this.signal });
      tell(t`Restored. The version before can be restored in turn.`);
      await this.load();
      this.clear();
    };
    fill(
      this.history,
      h("h2", {}, t`Versions`),
      h("p", {}, t`Now: version ${this.map.version}`, done.length > 0 && `, ${KINDS[done[0].kind]}`),
      versions.length === 0 && h("p", { class: "muted" }, t`No earlier version is kept.`),
      h(
        "ul",
        { class: "plain" },
        versions.map((one) =>
          h(
            "li",
            { class: "row spread" },
            h("span", { class: "small" }, t`Version ${one.version}, of ${when(one.created)}`),
            action(t`Restore`, () => restore(one)),
          ),
        ),
      ),
      done.length > 0 &&
        h(
          "details",
          {},
          h("summary", { class: "small" }, t`What was corrected`),
          h(
            "ol",
            { class: "plain small" },
            done.map(({ version, kind, created, residual_m: off }) =>
              h(
                "li",
                {},
                t`Version ${version}: ${KINDS[kind]}, ${when(created)}`,
                off !== null && off !== undefined && t`, off by ${length(off)}`,
              ),
            ),
          ),
        ),
    );
  }
}

/** The correction that adds a named point or area, or changes one; its kind and its fields stay where none are typed. */
function withNamed(names, which, { name, kind, fields }, place) {
  const before = names[which].find((one) => one.name === name.value) ?? { kind: "", fields: {} };
  const details = {
    kind: kind.value.trim() || before.kind,
    fields: fields.value.trim() ? fieldsOf(fields.value) : before.fields,
  };
  return {
    kind: "names",
    ...names,
    [which]: [...others(names[which], name.value), { name: name.value, ...details, ...place }],
  };
}

/** Fields that were typed as `name=value, …`: numbers, true and false as such, all else as text. */
export function fieldsOf(text) {
  const pairs = text.split(",").map((pair) => pair.split("=").map((part) => part.trim()));
  return Object.fromEntries(
    pairs
      .filter(([key]) => key)
      .map(([key, ...rest]) => {
        const value = rest.join("=");
        if (value === "true" || value === "false") return [key, value === "true"];
        return [key, value !== "" && Number.isFinite(Number(value)) ? Number(value) : value];
      }),
  );
}

const difference = ([from, to]) => from.map((value, i) => to[i] - value);
const others = (all, name) => all.filter((one) => one.name !== name);
const shown = (value) => String(Number(value.toFixed(DIGITS)));
const optional = (input) => (Number.isFinite(input.valueAsNumber) ? input.valueAsNumber : null);
const number = (properties = {}) => h("input", { type: "number", step: "any", ...properties });

/** The corners of a rectangle in the map's x and y. */
function rectangle([x0, y0], [x1, y1]) {
  return [
    [x0, y0, 0],
    [x1, y0, 0],
    [x1, y1, 0],
    [x0, y1, 0],
  ];
}

/** A direction that was drawn from a side, made to point up. */
export function upward(line, side) {
  const direction = difference(line);
  const sign = direction[2] < 0 || (side === Side.ABOVE && direction[1] < 0) ? -1 : 1;
  return direction.map((value) => sign * value);
}

/** How many landmarks are within corners, seen from above (even-odd rule). */
export function countInside(landmarks, corners) {
  let inside = 0;
  for (let i = 0; i < landmarks.length; i += 4) {
    const [x, y] = [landmarks[i], landmarks[i + 1]];
    let within = false;
    corners.forEach(([ax, ay], k) => {
      const [bx, by] = corners[(k + 1) % corners.length];
      if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) within = !within;
    });
    inside += Number(within);
  }
  return inside;
}
