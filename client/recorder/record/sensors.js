// The phone's inertial sensors, listened to.

import { accelerationSign, missingSensors, motionRow, rate, upward } from "./motion.js";
import { Problem } from "./problem.js";

const MEMORY_S = 1;

/** Accelerometer and gyroscope, for as long as the page listens. */
export class Sensors extends EventTarget {
  rows = []; // of the last second
  missing = null; // the names of missing sensors; null until the first event
  sign = 1;
  #up = null;

  /** Ask for the sensors, where the browser wants a tap for it, and listen. @throws {Problem} when they are refused. */
  async start() {
    if (!window.DeviceMotionEvent) {
      this.missing = ["accelerometer", "gyroscope"];
      return;
    }
    if (DeviceMotionEvent.requestPermission) {
      const answer = await DeviceMotionEvent.requestPermission().catch(() => "denied");
      if (answer !== "granted")
        throw new Problem("sensors-refused", "The motion sensors were refused.", "Reload the page and allow motion and orientation.");
    }
    addEventListener("deviceorientation", this);
    addEventListener("devicemotion", this);
  }

  stop() {
    removeEventListener("deviceorientation", this);
    removeEventListener("devicemotion", this);
  }

  handleEvent(event) {
    if (event.type === "deviceorientation") {
      if (Number.isFinite(event.beta) && Number.isFinite(event.gamma)) this.#up = upward(event);
      return;
    }
    this.missing = missingSensors(event);
    if (this.#up && event.accelerationIncludingGravity)
      this.sign = accelerationSign(event.accelerationIncludingGravity, this.#up) || this.sign;
    const row = motionRow(event, this.sign);
    if (!row || row[0] <= this.rows.at(-1)?.[0]) return;
    this.rows.push(row);
    this.forget(row[0]);
    this.dispatchEvent(new CustomEvent("row", { detail: row }));
  }

  /** The rows of the last second before `now`, in seconds. */
  recent(now) {
    this.forget(now);
    return this.rows;
  }

  /** Rows a second; null where there are no sensors at all. */
  hertz(now) {
    return this.missing === null || this.missing.length ? null : rate(this.recent(now).map((row) => row[0]));
  }

  forget(now) {
    const first = this.rows.findIndex((row) => row[0] >= now - MEMORY_S);
    this.rows.splice(0, first < 0 ? this.rows.length : first);
  }
}
