// Where a visitor is, between the server's answers: the direction by the phone's sensors, the uncertainty by how fast one walks.

const WALK_M_PER_S = 0.9;
const LOST_S = 8; // after which nothing is known any more
const UNKNOWN_SIGMA_M = 0.5; // of an answer that does not say

/** What is known of where the visitor is. Times are seconds, angles radians, anti-clockwise. */
export class Belief {
  constructor() {
    this.answer = null;
    this.turned = 0; // by the phone's sensors
  }

  /** Hear an answer of the server to a picture taken at a time, when the sensors said `turned`. */
  hear(answer, time, turned) {
    if (!answer.localized) return;
    const [x, y] = answer.heading;
    this.answer = { ...answer, time, turned, direction: Math.atan2(y, x) };
  }

  /** Hear how far the phone is turned by its sensors. */
  turn(turned) {
    this.turned = turned;
  }

  /** `{position, floor, direction, sigma}` at a time, or null where it is not known. */
  at(time) {
    const { answer } = this;
    if (!answer || time - answer.time > LOST_S) return null;
    const sigma = (answer.sigma_m ?? UNKNOWN_SIGMA_M) + WALK_M_PER_S * (time - answer.time);
    return {
      position: answer.position,
      floor: answer.floor,
      direction: answer.direction + this.turned - answer.turned,
      sigma,
    };
  }
}
