// A visitor's page: ways over walked ground, and what is known of where one is.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Belief } from "../../client/page/here/belief.js";
import { groundOf, guidance, lengthOf, Step, wayBetween } from "../../client/page/here/way.js";

// corridors of a building: a square of 20 m, and one through its middle
const WALKS = [
  [[0, 0], [20, 0], [20, 20], [0, 20], [0, 0]],
  [[10, 0], [10, 20]],
];
const onWalks = Array.from({ length: 20 }, (_, i) => (i % 2 ? [i, 0.2] : [10.3, i]));

/** The shortest way along the corridors' middles from a place on one to a place on another. */
function shortest(from, to) {
  const nodes = [[0, 0], [10, 0], [20, 0], [20, 20], [10, 20], [0, 20], from, to];
  const joined = ([a, b], [c, d]) =>
    (Math.abs(b - d) < 0.5 && (b < 0.5 || b > 19.5)) || (Math.abs(a - c) < 0.5 && (a < 0.5 || a > 19.5 || Math.abs(a - 10) < 0.5));
  const cost = nodes.map((_, i) => (i === 6 ? 0 : Infinity));
  for (let round = 0; round < nodes.length; round++)
    nodes.forEach((a, i) =>
      nodes.forEach((b, j) => {
        if (joined(a, b)) cost[j] = Math.min(cost[j], cost[i] + Math.hypot(a[0] - b[0], a[1] - b[1]));
      }),
    );
  return cost[7];
}

test("from any of 20 starts a way to any of 10 points is at most 1.2 times the shortest", () => {
  const ground = groundOf(WALKS);
  for (const from of onWalks) {
    for (const to of onWalks.slice(0, 10)) {
      const way = wayBetween(ground, from, to);
      assert.deepEqual([way[0], way.at(-1)], [from, to]);
      assert.ok(lengthOf(way) <= 1.2 * shortest(from, to) + 1.5, `${from} to ${to}: ${lengthOf(way)}`);
    }
  }
});

test("ways stay on walked ground, and there is none where no walk leads", () => {
  const way = wayBetween(groundOf(WALKS), [0, 10], [20, 10]);
  for (const [x, y] of way.slice(1, -1)) assert.ok([x, y].some((value) => Math.abs(value) < 1 || Math.abs(value - 20) < 1) || Math.abs(x - 10) < 1);
  assert.equal(wayBetween(groundOf([[[0, 0], [5, 0]], [[30, 0], [35, 0]]]), [0, 0], [32, 0]), null);
});

test("a way is told as a distance and a turn", () => {
  const way = [[0, 0], [12, 0], [12, 5]];
  assert.deepEqual(
    [guidance(way, 0).step, Math.round(guidance(way, 0).metres), guidance(way, 0).turn],
    [Step.GO, 12, 1],
  );
  assert.equal(guidance([[0, 0], [4, 0], [4, -5]], 0).turn, -1);
  assert.deepEqual([guidance(way, 2).step, Math.sign(guidance(way, 2).bearing)], [Step.TURN, -1]);
  assert.equal(guidance([[0, 0], [3, 0], [9, 0.5]], 0).turn, 0);
  assert.equal(guidance([[0, 0], [0.5, 0.5]], 0).step, Step.ARRIVED);
});

test("between answers the direction follows the phone, the doubt grows, and in the end nothing is known", () => {
  const belief = new Belief();
  assert.equal(belief.at(0), null);
  belief.hear({ localized: true, position: [1, 2, 1], heading: [0, 1, 0], sigma_m: 0.1, floor: "1" }, 10, 0.5);
  belief.turn(0.8);
  const now = belief.at(12);
  assert.ok(Math.abs(now.direction - (Math.PI / 2 + 0.3)) < 1e-9);
  assert.ok(now.sigma > 1 && now.sigma < 3);
  belief.hear({ localized: false }, 13, 0.8);
  assert.equal(belief.at(12.5).floor, "1");
  assert.equal(belief.at(30), null);
});
