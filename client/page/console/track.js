// A track as it is shown: the way so far, where it was lost, where it jumped, and how far each pose can be relied on.

import { h } from "../shared/dom.js";
import { coordinates, decimal, t } from "../shared/text.js";
import { length } from "./format.js";
import { facts } from "./parts.js";

/** How far a pose is to be relied on, as the server says it. */
export const Status = Object.freeze({ SEARCHING: "searching", TRACKING: "tracking", LOST: "lost" });

const BADGES = {
  [Status.SEARCHING]: ["warn", t`searching`],
  [Status.TRACKING]: ["good", t`tracking`],
  [Status.LOST]: ["bad", t`lost`],
};
const APART_M = 0.25; // from one ellipsoid along the way to the next

/**
 * What became of a track so far: `pieces` of the way, `{status, positions}`, each without a jump; `marks`, `{position,
 * covariance}`; `jumps`, in metres; and the last message, `now`. Messages are taken in one after the other.
 */
export class Track {
  pieces = [];
  marks = [];
  jumps = [];
  now = null;
  ended = false; // nobody follows it any more
  refused = null; // the last answer, while it has no pose

  take(message) {
    const { pose, status, reset_counter: resets, answer } = message;
    const before = this.now;
    if (answer) this.refused = answer.localized ? null : answer;
    this.now = message;
    if (!pose) return;
    const last = this.pieces.at(-1);
    const jumped = before !== null && resets > before.reset_counter;
    const from = last?.positions.at(-1);
    if (jumped && from) this.jumps.push(distance(from, pose.position));
    if (!last || jumped || last.status !== status || !before?.pose)
      this.pieces.push({ status, positions: !jumped && before?.pose && from ? [from] : [] });
    this.pieces.at(-1).positions.push(pose.position);
    const mark = this.marks.at(-1);
    if (!mark || distance(mark.position, pose.position) > APART_M)
      this.marks.push({ position: pose.position, covariance: message.covariance });
  }

  /** One standard deviation of the position, in metres; null while there is none. */
  get sigma() {
    const { covariance } = this.now ?? {};
    return covariance ? Math.sqrt(covariance[0][0] + covariance[1][1] + covariance[2][2]) : null;
  }
}

const distance = (a, b) => Math.hypot(...a.map((value, i) => value - b[i]));

/** Status, pose and history of a track, for people. `why` says what an answer without a pose means; `rate` is a text. */
export function trackReport(track, why, rate) {
  const { status, pose, answers, rejected, since_answer_s: since } = track.now;
  const [kind, text] = track.ended ? ["", t`stopped`] : BADGES[status];
  return [
    h("div", { class: "row" }, h("span", { class: ["badge", kind] }, text)),
    status === Status.LOST &&
      h("p", { class: "notice bad small" }, t`Too long without an answer of use: the pose is a guess.`),
    status !== Status.TRACKING && track.refused && why(track.refused),
    track.jumps.length > 0 &&
      h(
        "p",
        { class: "notice warn small" },
        t`The pose jumped by ${length(track.jumps.at(-1))}. The track before it may be wrong.`,
      ),
    facts([
      [t`Position`, pose ? `${coordinates(pose.position)} m` : "–"],
      [t`Heading`, pose ? coordinates(pose.heading) : "–"],
      [t`Off by about`, track.sigma === null ? t`unknown` : length(track.sigma)],
      [t`Answers`, t`${answers} of use, ${rejected} left aside`],
      [t`Last answer`, since === null || track.ended ? null : t`${decimal(since, 1)} s ago`],
      [t`Jumps`, track.jumps.length],
      [t`Rate`, rate],
    ]),
  ];
}
