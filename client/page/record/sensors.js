// The phone's inertial sensors, listened to.

import { t } from "../shared/text.js";
import { accelerationSign, missingSensors, motionRow, rate, upward } from "./motion.js";
import { Problem } from "./problem.js";

const MEMORY_S = 1;

let permission = null;

/**
 * Ask for the sensors where the browser wants that; it wants it in answer to a tap. The answer holds until one asks anew.
 * Resolves to whether they may be listened to.
 */
export function askForSensors() {
  /** @type {any} */
  const events = window.DeviceMotionEvent;
  const ask = events?.requestPermission;
  permission = ask
    ? ask.call(DeviceMotionEvent).then(
        (answer) => answer === "granted",
        () => false,
      )
    : Promise.resolve(true);
  return permission;
}

/** Accelerometer and gyroscope, for as long as the page listens. */
export class Sensors extends EventTarget {
  rows = []; // of the last second
  missing = null; // the names of missing sensors; null until the first event
  sign = 1;
  #up = null;

  /** Listen. @throws {Problem} when the sensors were refused. */
  async start() {
    if (!(await (permission ?? askForSensors())))
      throw new Problem(
        "sensors-refused",
        t`The motion sensors were refused.`,
        t`With them the map knows its size and what is up. Allow motion and orientation for this page, or record video alone.`,
      );
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
