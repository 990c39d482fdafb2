import assert from "node:assert/strict";
import { test } from "node:test";

import { inPlainWords, mistakesIn, mostTrusted, restsOnGivenPoses, Trust, trustOf, whatToDo } from "../../client/page/shared/trust.js";

const FIGURES = "3.1% of the median depth and 1.2° apart, nine in ten keyframes within 5.4%.";

test("a map is trusted, not trusted, or nobody knows", () => {
  assert.deepEqual(
    [true, false, null, undefined].map((trusted) => trustOf({ trusted })),
    [Trust.YES, Trust.NO, Trust.UNKNOWN, Trust.UNKNOWN],
  );
});

test("a checked map comes first, one that is not trusted last", () => {
  const [no, given, yes] = [
    { trusted: false, trust_reason: "The poses were given." },
    { trusted: true, trust_reason: "The poses were given." },
    { trusted: true, trust_reason: "Pictures and IMU agree." },
  ];
  assert.equal(mostTrusted([no, given, yes]), yes);
  assert.equal(mostTrusted([no, given]), given);
  assert.equal(mostTrusted([no]), no);
  assert.deepEqual([no, given, yes].map(restsOnGivenPoses), [false, true, false]);
});

test("figures about reconstructions become plain words, and what else is said stays", () => {
  const { plain, technical } = inPlainWords(`Two reconstructions disagree: ${FIGURES} A waypoint is missed by 0.31 m.`);
  assert.match(plain, /two different shapes.*A waypoint is missed by 0\.31 m\.$/);
  assert.doesNotMatch(plain, /nine in ten/);
  assert.match(technical, /nine in ten/);
  assert.match(inPlainWords(`Two reconstructions agree: ${FIGURES}`).plain, /came out in the same shape\.$/);
  assert.deepEqual(inPlainWords("The poses were given."), { plain: "The poses were given.", technical: null });
  assert.equal(inPlainWords(""), null);
  assert.equal(inPlainWords("Its poses are expected to be right to 4.5 cm."), null); // the page says it once, elsewhere
  assert.equal(inPlainWords("Its poses are expected to be right to 4.5 cm. W2 is missed.").plain, "W2 is missed.");
});

test("mistakes are found in reports of any make", () => {
  const report = { trajectories: [{ waypoint_mistake: "W2 is mistyped." }, { waypoint_mistake: null }], learned: [{}] };
  assert.deepEqual(mistakesIn(report), ["W2 is mistyped."]);
  for (const strange of [null, {}, { trajectories: 7 }, { trajectories: [null] }]) assert.deepEqual(mistakesIn(strange), []);
});

test("what to do follows from what is wrong", () => {
  assert.equal(whatToDo(Trust.YES), null);
  assert.match(whatToDo(Trust.NO), /Record the walk again/);
  assert.match(whatToDo(Trust.NO, ["W2 is mistyped."]), /Measure that point again/);
});
