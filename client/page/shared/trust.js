// Whether a map can be relied on, why, and what to do where it cannot.

import { heard, t } from "./text.js";

const EXPECTED = /Its poses are expected to be right to [\d.]+ cm\.\s*/; // the page says it in a place of its own

/** How far a map may be relied on. */
export const Trust = Object.freeze({ YES: "yes", NO: "no", UNKNOWN: "unknown" });

/** What a map says of itself; null where it does not know, or the server does not send it. */
export const trustOf = ({ trusted }) => (trusted === true ? Trust.YES : trusted === false ? Trust.NO : Trust.UNKNOWN);

/** What a map's report says of mistakes in measured points. It comes with its map, from anywhere, and may say anything. */
export function mistakesIn(report) {
  const walks = [report?.trajectories ?? [], report?.learned ?? []].flat();
  return walks.map((walk) => walk?.waypoint_mistake).filter((text) => typeof text === "string" && text);
}

/** Whether a map is trusted only because nobody doubted the poses that came with its recording. */
export const restsOnGivenPoses = ({ trusted, trust_reason: why }) =>
  trusted === true && why === "The poses were given.";

/** The one of several maps that is shown first where nobody chose: a checked one before others, as listed. */
export const mostTrusted = (maps) =>
  maps.find((map) => map.trusted === true && !restsOnGivenPoses(map)) ??
  maps.find((map) => map.trusted !== false) ??
  maps[0];

/** A reason as the server gives it, and where it is full of figures, what they mean. */
export function inPlainWords(why) {
  if (typeof why !== "string" || !why.replace(EXPECTED, "")) return null;
  why = why.replace(EXPECTED, "");
  const disagree = /Two reconstructions disagree[^.]*(\.\d[^.]*)*\./;
  const agree = /Two reconstructions agree[^.]*(\.\d[^.]*)*\./;
  const unchecked = /Only \d+ of \d+ keyframes could be checked\./;
  if (disagree.test(why))
    return {
      plain: heard(why).replace(
        disagree,
        t`Reconstructed twice from different pictures, the walk came out in two different shapes: somewhere the map is wrong.`,
      ),
      technical: why,
    };
  if (agree.test(why))
    return {
      plain: heard(why).replace(
        agree,
        t`Reconstructed twice from different pictures, the walk came out in the same shape.`,
      ),
      technical: why,
    };
  if (unchecked.test(why))
    return {
      plain: heard(why).replace(
        unchecked,
        t`Too little of the walk could be reconstructed a second time to check its shape.`,
      ),
      technical: why,
    };
  return { plain: heard(why), technical: null };
}

/** Whether what speaks against a map, or is to be corrected in it, are its measured points. */
export const blamesPoints = (mistakes, why) => mistakes.length > 0 || /The waypoint .+ is missed by/.test(why ?? "");

/** What to do with a map that can be relied on. */
export const nextForGood = () =>
  t`Try it with a few pictures from where it will be used. Its page shows where it works less well, and where to walk next.`;

/** What to do about a map that cannot be relied on because of `why`; `mistakes` are of measured points. */
export function whatToDo(trust, mistakes = [], why = "") {
  if (mistakes.length) return t`Measure that point again, correct it, and map the recording again.`;
  if (trust === Trust.YES) return null;
  if (trust === Trust.NO && blamesPoints(mistakes, why))
    return t`Check the points that are missed: mistyped, exchanged, or marked elsewhere? Correct them in the recording, and map it again.`;
  if (trust === Trust.NO)
    return t`Record the walk again: slowly, sideways rather than turning on the spot, and back to where you began. Measured points let the map check itself.`;
  return t`Build it again with this version to have it checked.`;
}
