// Where those are who ask for poses, between their answers: moved smoothly from one to the next.

import { meanRotation } from "../../js/poses.js";

const FASTEST_S = 0.05; // between two answers of one asker
const SLOWEST_S = 1; // that a way from one answer to the next is drawn in
const SETTLED_S = 0.05; // after an arrival, so that it is drawn, too
const RATE_OVER = 10; // answers that a rate is measured over

/** Answers by asker; times are seconds of one clock. */
export class Motions {
  #askers = new Map();

  /** An answer came, as `/v1/maps/{map}/live` sends it. */
  hear(answer, now) {
    const known = this.#askers.get(answer.asker);
    const from = known?.answer.T_map_camera ? between(known, now) : answer.T_map_camera;
    const heard = [...(known?.heard ?? []), now].slice(-RATE_OVER);
    const apart = known ? now - known.since : 0;
    const span = Math.min(SLOWEST_S, Math.max(FASTEST_S, apart));
    this.#askers.set(answer.asker, { answer, from, since: now, span, heard });
  }

  /** Everyone who was heard of lately, by name: what was answered last, how often they ask, and how long ago that was. */
  all(now, within) {
    return [...this.#askers]
      .filter(([, { since }]) => now - since < within)
      .sort(([a], [b]) => a.localeCompare(b))
      .map(([asker, { answer, heard, since }]) => ({ asker, answer, hertz: rate(heard), age: now - since }));
  }

  /** Whether anyone is on the way from one answer to the next. */
  moving(now) {
    return [...this.#askers.values()].some(({ since, span }) => now - since < span + SETTLED_S);
  }

  /** Where everyone is at a moment whose pose is known: `{asker, T, stale}`. */
  now(now, stale, within) {
    return [...this.#askers]
      .filter(([, { answer, since }]) => answer.T_map_camera && now - since < within)
      .map(([asker, known]) => ({
        asker,
        T: between(known, now),
        stale: now - known.since > stale,
      }));
  }
}

const rate = (heard) => (heard.length > 1 ? (heard.length - 1) / (heard.at(-1) - heard[0] || 1) : 0);

/** The pose on the way from the one before to the last answer. */
function between({ answer, from, since, span }, now) {
  const share = Math.min(1, (now - since) / span);
  const to = answer.T_map_camera;
  if (share >= 1 || !from) return to;
  const R = meanRotation([from, to], [1 - share, share]);
  return [...R.map((row, i) => [...row, from[i][3] + share * (to[i][3] - from[i][3])]), [0, 0, 0, 1]];
}
