// A floor plan beside a map: opened from this device, never uploaded, and points of it clicked.

import { resolvedColour } from "../shared/colours.js";
import { h } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { metresPerPixel, readPlan } from "./floor_plan.js";
import { tell } from "./parts.js";
import { drawPin } from "./plan_view.js";

/** `element` shows the plan; `clicked([x, y])` hears of points, from its lower left corner, in its own unit: pixels or metres. */
export class PlanPicture {
  constructor(clicked) {
    this.plan = null;
    this.pins = [];
    this.typed = [null, null];
    this.canvas = h("canvas", { class: "plan-picture", role: "img", "aria-label": t`Floor plan`, hidden: true });
    this.canvas.addEventListener("click", ({ offsetX: x, offsetY: y }) => {
      const size = this.plan.width / this.canvas.clientWidth;
      clicked([x * size, this.plan.height - y * size]);
    });
    this.changed = () => {};
    this.file = h("input", { type: "file", accept: "image/*,.json,.geojson", onchange: () => this.open() });
    this.width = h("input", { type: "number", min: 0.01, step: "any", oninput: () => this.changed() });
    this.scale = h("input", { type: "checkbox", onchange: () => this.changed() });
    this.element = h("div", { class: "stack", hidden: true }, this.canvas);
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  /** Width and height of what is open, or null. */
  get size() {
    return this.plan && [this.plan.width, this.plan.height];
  }

  /** Whether the map is to take the plan's scale. */
  get scaled() {
    return this.scale.checked;
  }

  async open() {
    const [file] = this.file.files;
    if (!file) return;
    try {
      this.plan = await readPlan(file);
    } catch (error) {
      tell(error.message, "bad");
      return;
    }
    this.canvas.hidden = false;
    this.width.disabled = !this.plan.image; // GeoJSON is in metres
    this.canvas.style.aspectRatio = `${this.plan.width} / ${this.plan.height}`;
    this.draw();
    this.changed();
  }

  /** What is asked of a plan. */
  fields(metric, changed) {
    this.changed = changed;
    if (!metric) this.scale.checked = true;
    return [
      field(t`Picture or GeoJSON`, this.file, t`It stays on this device.`),
      field(t`Width of the plan, m`, this.width, metric ? t`Without it, the map's own scale tells.` : null),
      h("label", { class: "check" }, this.scale, t`The map takes the plan's scale`),
    ];
  }

  /** Metres for one unit of the plan: by its width, or by two points where the map is metric; 1 for GeoJSON. */
  perPixel(mapPins, planPins) {
    if (this.plan && !this.plan.image) return 1;
    const width = this.width.valueAsNumber;
    return width > 0 ? width / this.plan.width : metresPerPixel(mapPins, planPins);
  }

  /** How the plan lies on the map, by two points of both, as a `PlanView` draws it. */
  placed(mapPins, planPins) {
    const perPixel = this.perPixel(mapPins, planPins);
    const angle = ([a, b]) => Math.atan2(b[1] - a[1], b[0] - a[0]);
    const turn = angle(mapPins) - angle(planPins);
    const middle = ([a, b]) => [0, 1].map((i) => (a[i] + b[i]) / 2);
    const [x, y] = middle(planPins).map((value) => value * perPixel);
    const [mx, my] = middle(mapPins);
    const corner = [mx - x * Math.cos(turn) + y * Math.sin(turn), my - x * Math.sin(turn) - y * Math.cos(turn)];
    return { image: this.plan.image, lines: this.plan.lines, corner, turn, perPixel };
  }

  /** The same once the map has the plan's frame. */
  asFrame(mapPins, planPins) {
    return { ...this.placed(mapPins, planPins), corner: [0, 0], turn: 0 };
  }

  pin(points) {
    this.pins = points;
    this.draw();
  }

  draw() {
    if (!this.plan || !this.canvas.clientWidth) return;
    const ratio = Math.min(devicePixelRatio, 2);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    const colour = (token) => resolvedColour(this.canvas, token);
    const size = width / this.plan.width;
    if (this.plan.image) context.drawImage(this.plan.image, 0, 0, width, height);
    context.strokeStyle = colour("--ink");
    for (const line of this.plan.lines ?? []) {
      context.beginPath();
      line.forEach(([x, y], i) => {
        if (i) context.lineTo(x * size, height - y * size);
        else context.moveTo(x * size, height - y * size);
      });
      context.stroke();
    }
    this.pins.forEach(([x, y], i) => {
      drawPin(context, [x * size, height - y * size], "AB"[i], colour);
    });
  }
}
