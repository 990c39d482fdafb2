// The camera's picture, what is measured meanwhile, and the buttons of a recording.

import { fill, h } from "../../shared/dom.js";
import { t, translated } from "../../shared/text.js";
import { facesAway, openCamera, pictureMeter } from "../camera.js";
import { advice, flaws, LEAST_RATE_HZ, rollDegrees, turnRate } from "../coaching.js";
import { draft, keepDraft } from "../draft.js";
import { Headings } from "../headings.js";
import { LoopWatch } from "../loop_watch.js";
import { Problem } from "../problem.js";
import { Readings } from "../readings.js";
import { askForSensors, Sensors } from "../sensors.js";
import { Take } from "../take.js";
import { freeName, marked, nextRow } from "../waypoints.js";
import { meters } from "./meters.js";
import { ring } from "./ring.js";
import { waypointList } from "./waypoint_list.js";
import { duration, size } from "./words.js";

const MEASURE_MS = 250;
const CALM_MS = 1200; // how long an advice stays at least
const SMOOTHING = 0.5; // of what is measured, from one measurement to the next

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
      h("button", { class: "primary", onclick: again }, t`Try again`),
      sensors && h("button", { onclick: () => open(false) }, t`Record video alone`),
      h("a", { class: "button", href: "#/" }, t`Back`),
    ),
  );
}

class Live {
  #take = null;
  #marks = draft().waypoints.map((waypoint) => ({ ...waypoint, time: null }));
  #smooth = { light: null, texture: null, sharpness: null };
  #readings = new Readings();
  #advised = { code: null, since: 0 };
  #headings = new Headings();
  #watch = null; // for loops, while recording
  #held = false; // whether the present loop was announced

  constructor(store) {
    this.store = store;
    this.sensors = new Sensors();
    this.video = h("video", { muted: true, playsinline: true, autoplay: true, "aria-label": t`The camera's picture` });
    this.video.muted = true;
    this.time = h("strong", { class: "time", role: "timer", hidden: true });
    this.imu = h("span", { class: "badge" }, t`Sensors …`);
    this.meters = meters();
    this.ring = ring();
    this.advice = h("p", { class: "advice", role: "status", "aria-live": "polite" });
    this.waypoint = h("button", { class: "waypoint", onclick: () => this.mark() });
    this.record = h("button", {
      class: "shutter",
      "aria-label": t`Record`,
      disabled: true,
      onclick: () => this.toggle(),
    });
    this.points = h("button", { onclick: () => this.editPoints() }, t`Points`);
    this.back = h("a", { class: "button", href: "#/" }, t`Back`);
    this.element = h(
      "section",
      { class: "viewfinder", "aria-label": t`Recording` },
      this.video,
      h("div", { class: "readings" }, this.time, this.imu, this.meters.element, this.ring.element),
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
    this.meter = pictureMeter(this.video);
    this.timer = setInterval(() => this.measure(), MEASURE_MS);
    this.wakeLock = await navigator.wakeLock?.request("screen").catch(() => null);
    this.record.disabled = false;
  }

  close() {
    this.#take?.stop();
    this.sensors.removeEventListener("row", this.turned);
    clearInterval(this.timer);
    this.sensors.stop();
    for (const track of this.stream?.getTracks() ?? []) track.stop();
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
    this.#readings = new Readings();
    this.#headings = new Headings();
    this.#watch = new LoopWatch(this.video);
    this.sensors.addEventListener("row", this.turned);
    this.#take = new Take(this.store, recording, this);
    this.#take.start();
    this.#take.ended.then((ended) => this.end(ended));
    this.element.classList.add("recording");
    this.time.hidden = false;
    this.back.hidden = true;
    this.record.setAttribute("aria-label", t`Stop`);
    this.showWaypoint();
    this.measure();
  }

  async end(recording) {
    const { darkest } = this.#readings;
    const { works, loops, views } = this.#watch ?? {};
    const seen = works ? { loops, views } : {};
    const kept = { ...recording, ...seen, waypoints: this.#marks, darkest, seconds: this.#readings.seconds() };
    this.#watch?.close();
    await this.store.save(kept);
    location.hash = `#/review/${recording.id}`;
  }

  mark() {
    const marks = marked(this.#marks, Take.now());
    if (marks === this.#marks) return;
    this.#marks = marks;
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
    const next = this.#marks[nextRow(this.#marks)] ?? { name: freeName(this.#marks) };
    fill(this.waypoint, t`Mark a point:`, " ", h("strong", {}, next.name));
    this.waypoint.hidden = this.#take === null;
    this.points.textContent = t`Points (${this.#marks.filter(({ time }) => time !== null).length})`;
  }

  editPoints() {
    const list = waypointList(this.#marks, (waypoints) => (this.#marks = waypoints), this.#take?.recording.started);
    const dialog = h(
      "dialog",
      { class: "wide", "aria-label": t`Points` },
      h(
        "div",
        { class: "stack" },
        h("h2", {}, t`Measured points`),
        list,
        h("button", { class: "primary", onclick: () => dialog.close() }, t`Done`),
      ),
    );
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
    const imuHz = this.sensors.hertz(now);
    this.showImu(imuHz);
    const turnDegS = rows.length ? turnRate(rows) : null;
    const measured = { ...this.smoothed(this.meter()), turnDegS };
    this.meters.show(measured);
    if (this.#take) {
      const { elapsed, recording } = this.#take;
      this.#readings.add(elapsed, measured);
      recording.seconds = this.#readings.seconds(); // kept with the next part
      if (!flaws(measured).length) this.#headings.look(MEASURE_MS / 1000);
      this.#watch.look(elapsed);
      this.ring.show(this.#headings, this.#watch.views, this.#watch.loops);
      this.time.textContent = `${duration(elapsed)} · ${size(recording.bytes)}`;
    }
    const rollDeg = rows.length ? rollDegrees(rows.at(-1).slice(1, 4), screen.orientation?.angle) : null;
    this.advise(this.loopAdvice() ?? advice({ ...measured, rollDeg, imuHz, stoodS: this.#watch?.stoodS }));
  }

  /** What to do where the walk has been before; said once each time. */
  loopAdvice() {
    if (!this.#take || !this.#watch?.here) {
      this.#held = false;
      return null;
    }
    if (!this.#held) navigator.vibrate?.([60, 60, 60]);
    this.#held = true;
    return { code: "loop", text: t`You have been here before: hold still for two seconds.` };
  }

  turned = (event) => this.#headings.turn(/** @type {CustomEvent} */ (event).detail);

  /** Measurements of the picture that do not flicker. */
  smoothed(seen) {
    for (const [name, value] of Object.entries(seen)) {
      const before = this.#smooth[name];
      this.#smooth[name] = value === null || before === null ? value : SMOOTHING * before + (1 - SMOOTHING) * value;
    }
    return { ...this.#smooth };
  }

  showImu(imuHz) {
    const { missing } = this.sensors;
    const slow = imuHz !== null && imuHz < LEAST_RATE_HZ;
    const text = missing?.length
      ? t`No ${missing.map(translated).join(t`, no `)}: video only`
      : imuHz === null
        ? t`No motion sensors: video only`
        : t`Sensors ${Math.round(imuHz)} Hz`;
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
