// A floor plan beside a map: opened from this device, points of it clicked, and kept with the map once it lies there.

import { resolvedColour } from "../shared/colours.js";
import { h, tell } from "../shared/dom.js";
import { field } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { GEOJSON, metresPerPixel, readPlan } from "./floor_plan.js";
import { drawPin } from "./plan_view.js";

const KEPT_AS_IT_IS = ["image/png", "image/jpeg", "image/webp"];
const MOST_BYTES = 4_000_000; // larger pictures are made smaller
const MOST_PX = 3000;

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
      field(t`Picture or GeoJSON`, this.file, t`It is kept with the map.`),
      field(t`Width of the plan, m`, this.width, metric ? t`Without it, the map's own scale counts.` : null),
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

  /** What is kept of it, as the service takes it: `{body, unit}`, the length of its unit in units of the plan. */
  async content() {
    const [file] = this.file.files;
    if (!this.plan.image) return { body: new Blob([file], { type: GEOJSON }), unit: 1 };
    if (KEPT_AS_IT_IS.includes(file.type) && file.size <= MOST_BYTES) return { body: file, unit: 1 };
    const unit = Math.max(1, Math.max(...this.size) / MOST_PX);
    const [width, height] = this.size.map((length) => Math.round(length / unit));
    const canvas = h("canvas", { width, height });
    canvas.getContext("2d").drawImage(this.plan.image, 0, 0, width, height);
    const body = await new Promise((resolve) => canvas.toBlob(resolve, "image/webp"));
    return { body, unit };
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
