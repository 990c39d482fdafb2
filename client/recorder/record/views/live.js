// The camera's picture, what is measured meanwhile, and the buttons of a recording.

import { fill, h } from "../../shared/dom.js";
import { facesAway, lightMeter, openCamera } from "../camera.js";
import { advice, LEAST_RATE_HZ, rollDegrees, turnRate } from "../coaching.js";
import { draft, keepDraft } from "../draft.js";
import { Problem } from "../problem.js";
import { askForSensors, Sensors } from "../sensors.js";
import { Take } from "../take.js";
import { complete, freeName, marked, nextRow } from "../waypoints.js";
import { lightCurve } from "./light_curve.js";
import { waypointList } from "./waypoint_list.js";
import { duration, percent, size } from "./words.js";

const MEASURE_MS = 250;
const CALM_MS = 1200; // how long an advice stays at least
const SMOOTHING = 0.5; // of brightness, from one measurement to the next

/** Preview, then recording. */
export async function liveView({ content, store }) {
  let live;
  const open = async (withSensors) => {
    live = new Live(store);
    fill(content, live.element);
    document.body.classList.add("live");
    try {
      await live.open(withSensors);
    } catch (error) {
      live.close();
      if (!(error instanceof Problem)) throw error;
      fill(content, refusal(error, open));
    }
  };
  await open(true);
  return () => live.close();
}

function refusal(problem, open) {
  const again = () => {
    askForSensors(); // now, in answer to the tap
    return open(true);
  };
  const sensors = problem.code === "sensors-refused";
  return h(
    "div",
    { class: "stack narrow" },
    h("h1", {}, problem.title),
    h("p", { class: "notice bad", role: "alert" }, problem.advice),
    h(
      "div",
      { class: "row" },
      h("button", { class: "primary", onclick: again }, "Try again"),
      sensors && h("button", { onclick: () => open(false) }, "Record video alone"),
      h("a", { class: "button", href: "#/" }, "Back"),
    ),
  );
}

class Live {
  #take = null;
  #marks = draft().waypoints.map((waypoint) => ({ ...waypoint, time: null }));
  #light = null;
  #lights = [];
  #advised = { code: null, since: 0 };

  constructor(store) {
    this.store = store;
    this.sensors = new Sensors();
    this.video = h("video", { muted: true, playsinline: true, autoplay: true, "aria-label": "The camera's picture" });
    this.video.muted = true;
    this.time = h("strong", { class: "time", role: "timer", hidden: true });
    this.imu = h("span", { class: "badge" }, "Sensors …");
    this.lightBadge = h("span", { class: "badge" }, "Light …");
    this.curve = lightCurve();
    this.advice = h("p", { class: "advice", role: "status", "aria-live": "polite" });
    this.waypoint = h("button", { class: "waypoint", disabled: true, onclick: () => this.mark() });
    this.record = h("button", { class: "shutter", "aria-label": "Record", disabled: true, onclick: () => this.toggle() });
    this.points = h("button", { onclick: () => this.editPoints() }, "Points");
    this.back = h("a", { class: "button", href: "#/" }, "Back");
    this.element = h(
      "section",
      { class: "viewfinder", "aria-label": "Recording" },
      this.video,
      h("div", { class: "readings" }, this.time, this.imu, this.lightBadge, this.curve.element),
      this.advice,
      h("div", { class: "controls" }, this.waypoint, h("div", { class: "row" }, this.back, this.record, this.points)),
    );
    this.showWaypoint();
  }

  async open(withSensors) {
    if (withSensors) await this.sensors.start();
    this.stream = await openCamera();
    this.video.srcObject = this.stream;
    await this.video.play();
    this.meter = lightMeter(this.video);
    this.timer = setInterval(() => this.measure(), MEASURE_MS);
    this.wakeLock = await navigator.wakeLock?.request("screen").catch(() => null);
    this.record.disabled = false;
  }

  close() {
    this.#take?.stop();
    clearInterval(this.timer);
    this.sensors.stop();
    this.stream?.getTracks().forEach((track) => track.stop());
    this.wakeLock?.release();
    document.body.classList.remove("live");
  }

  toggle() {
    if (this.#take) this.#take.stop();
    else this.begin();
  }

  begin() {
    const { map } = draft();
    const recording = {
      id: crypto.randomUUID(),
      created: Date.now(),
      map,
      waypoints: this.#marks,
      screenAngle: screen.orientation?.angle ?? 0,
      facesAway: facesAway(this.stream),
    };
    this.#lights = [];
    this.#take = new Take(this.store, recording, this);
    this.#take.start();
    this.#take.ended.then((ended) => this.end(ended));
    this.element.classList.add("recording");
    this.time.hidden = false;
    this.back.hidden = true;
    this.record.setAttribute("aria-label", "Stop");
    this.showWaypoint();
    this.measure();
  }

  async end(recording) {
    const lights = this.#lights;
    const kept = { ...recording, waypoints: this.#marks, darkest: lights.length ? Math.min(...lights) : null };
    await this.store.save(kept);
    location.hash = `#/review/${recording.id}`;
  }

  mark() {
    this.#marks = marked(this.#marks, Take.now());
    navigator.vibrate?.(50);
    this.remember();
  }

  /** Marks are kept with the next part, and coordinates for the next recording. */
  remember() {
    if (this.#take) this.#take.recording.waypoints = this.#marks;
    keepDraft({ waypoints: this.#marks.map((waypoint) => ({ ...waypoint, time: null })) });
    this.showWaypoint();
  }

  showWaypoint() {
    const next = this.#marks[nextRow(this.#marks)] ?? { name: freeName(this.#marks), position: [null] };
    const measured = next.position.every(Number.isFinite);
    const told = measured ? next.position.map((value) => value.toFixed(2)).join(", ") : "coordinates may follow later";
    fill(this.waypoint, h("strong", {}, next.name), h("span", { class: "small" }, this.#take ? told : "Mark points while recording"));
    this.waypoint.disabled = this.#take === null;
    this.points.textContent = `Points (${complete(this.#marks).length})`;
  }

  editPoints() {
    const list = waypointList(this.#marks, (waypoints) => (this.#marks = waypoints), this.#take?.recording.started);
    const dialog = h("dialog", { class: "wide", "aria-label": "Points" }, h("div", { class: "stack" }, h("h2", {}, "Measured points"), list, h("button", { class: "primary", onclick: () => dialog.close() }, "Done")));
    dialog.addEventListener("close", () => {
      dialog.remove();
      this.remember();
    });
    this.element.append(dialog);
    dialog.showModal();
  }

  measure() {
    const now = Take.now();
    const rows = this.sensors.recent(now);
    const seen = this.meter();
    this.#light = seen === null || this.#light === null ? seen : SMOOTHING * this.#light + (1 - SMOOTHING) * seen;
    const imuHz = this.sensors.hertz(now);
    this.showImu(imuHz);
    if (this.#light !== null) this.lightBadge.textContent = `Light ${percent(this.#light)}`;
    if (this.#take) {
      if (this.#light !== null) this.#lights.push(this.#light);
      this.curve.show(this.#lights);
      const { elapsed, recording } = this.#take;
      this.time.textContent = `${duration(elapsed)} · ${size(recording.bytes)}`;
    }
    const rollDeg = rows.length ? rollDegrees(rows.at(-1).slice(1, 4), screen.orientation?.angle) : null;
    this.advise(advice({ turnDegS: turnRate(rows), light: this.#light, rollDeg, imuHz }));
  }

  showImu(imuHz) {
    const { missing } = this.sensors;
    const slow = imuHz !== null && imuHz < LEAST_RATE_HZ;
    const text = missing?.length ? `No ${missing.join(", no ")}: video only` : imuHz === null ? "No motion sensors: video only" : `Sensors ${Math.round(imuHz)} Hz`;
    this.imu.textContent = text;
    this.imu.className = `badge ${slow || imuHz === null ? "warn" : "good"}`;
  }

  /** Show an advice long enough to be read. */
  advise(next) {
    const now = performance.now();
    if (next?.code === this.#advised.code || now - this.#advised.since < CALM_MS) return;
    this.#advised = { code: next?.code, since: now };
    this.advice.textContent = next?.text ?? "";
    this.advice.dataset.code = next?.code ?? "";
  }
}
