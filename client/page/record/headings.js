// Which directions a walk has looked in, from the gyroscope: turns about the vertical, added up from the start.

export const SECTORS = 12;
export const ENOUGH_S = 1; // of good pictures in a direction
const LONGEST_STEP_S = 0.2; // between two rows; over a gap nothing is known
const SETTLING = 0.02; // of the upward direction, from one row to the next

/** Directions are counted from the first one, to the right. */
export class Headings {
  heading = 0; // rad, to the right of the first
  seen = new Float64Array(SECTORS); // seconds of good pictures
  #up = null;
  #time = null;

  /** A row of Table 3 in the device's axes. */
  turn([time, ax, ay, az, gx, gy, gz]) {
    const length = Math.hypot(ax, ay, az) || 1;
    const now = [ax / length, ay / length, az / length];
    this.#up = this.#up?.map((value, i) => value + SETTLING * (now[i] - value)) ?? now;
    const step = this.#time === null ? 0 : time - this.#time;
    this.#time = time;
    if (step <= 0 || step > LONGEST_STEP_S) return;
    const [ux, uy, uz] = this.#up;
    this.heading -= (step * (gx * ux + gy * uy + gz * uz)) / (Math.hypot(ux, uy, uz) || 1);
  }

  /** The sector that is looked in. */
  get sector() {
    const turns = this.heading / (2 * Math.PI);
    return Math.round((turns - Math.floor(turns)) * SECTORS) % SECTORS;
  }

  /** So many seconds of good pictures were taken in the present direction. */
  look(seconds) {
    this.seen[this.sector] += seconds;
  }

  /** How many directions have been seen for long enough. */
  get covered() {
    return this.seen.filter((seconds) => seconds >= ENOUGH_S).length;
  }
}
