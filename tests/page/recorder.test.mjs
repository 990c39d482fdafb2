import assert from "node:assert/strict";
import { test } from "node:test";

import { advice, BAREST, brightness, Flaw, flaws, LEAST_SHARP, sharpness, texture } from "../../client/page/record/coaching.js";
import { flawedSpans, Readings } from "../../client/page/record/readings.js";
import { added, marked, planned } from "../../client/page/record/waypoints.js";

const [WIDTH, HEIGHT] = [160, 120];

/** A wall of bricks, whose edges are as many pixels wide as it is blurred. */
function bricks(blur = 0) {
  const raw = Float32Array.from({ length: WIDTH * HEIGHT }, (_, i) => {
    const [x, y] = [i % WIDTH, Math.floor(i / WIDTH)];
    return ((Math.floor(x / 12) + Math.floor(y / 9)) % 2) * 140 + 50;
  });
  let picture = raw;
  for (let round = 0; round < blur; round++) {
    picture = picture.map((_, i) => {
      const around = [-1 - WIDTH, -WIDTH, 1 - WIDTH, -1, 0, 1, WIDTH - 1, WIDTH, WIDTH + 1].map((by) => picture[i + by] ?? picture[i]);
      return around.reduce((sum, value) => sum + value, 0) / 9;
    });
  }
  return picture;
}

test("bricks are sharp and textured, blurred ones not sharp, a bare wall neither", () => {
  const measured = (picture) => ({ texture: texture(picture, WIDTH, HEIGHT), sharpness: sharpness(picture, WIDTH, HEIGHT) });
  const sharp = measured(bricks());
  assert.ok(sharp.sharpness > 0.9 && sharp.texture > 0.8, JSON.stringify(sharp));
  assert.ok(measured(bricks(6)).sharpness < LEAST_SHARP);
  const wall = Float32Array.from({ length: WIDTH * HEIGHT }, (_, i) => 180 + 8 * Math.sin(i * 12.9898));
  assert.ok(measured(wall).texture < BAREST);
  assert.equal(measured(wall).sharpness, null);
  assert.equal(brightness(new Float32Array([0, 255])), 0.5);
});

test("the worst is said first, and what is not known is not complained of", () => {
  assert.deepEqual(flaws({ turnDegS: 90, light: 0.05, texture: 0, sharpness: 0.1 }), [
    Flaw.TOO_FAST,
    Flaw.TOO_DARK,
    Flaw.BARE,
    Flaw.BLURRED,
  ]);
  assert.deepEqual(flaws({}), []);
  assert.equal(advice({ texture: 0.01 }).code, Flaw.BARE);
  assert.equal(advice({ rollDeg: -40 }).code, "not-upright");
  assert.equal(advice({ rollDeg: 3, imuHz: 60, light: 0.5, texture: 0.7, sharpness: 0.8, turnDegS: 10 }), null);
});

test("a second has the flaws of most of its measurements, and seconds make spans", () => {
  const readings = new Readings();
  const fine = { light: 0.5, texture: 0.7, sharpness: 0.8, turnDegS: 5 };
  for (let i = 0; i < 40; i++) {
    const second = Math.floor(i / 4);
    const bare = [3, 4, 6].includes(second) || i === 0;
    readings.add(i / 4, bare ? { ...fine, texture: 0 } : fine);
  }
  assert.deepEqual(
    readings.seconds().map((found) => found.length),
    [0, 0, 0, 1, 1, 0, 1, 0, 0, 0],
  );
  assert.deepEqual(flawedSpans(readings.seconds()), [{ flaw: Flaw.BARE, from: 3, to: 7 }]);
  assert.equal(readings.darkest, 0.5);
  assert.equal(new Readings().darkest, null);
});

test("a double tap marks once, and an added point stands before the end", () => {
  let points = marked(planned(), 10);
  points = marked(points, 10.4);
  assert.deepEqual(points.map(({ time }) => time), [10, null, null, null]);
  assert.deepEqual(added(points).map(({ name }) => name), ["W1", "W2", "W3", "W4", "E"]);
  const ended = points.map((point, i) => ({ ...point, time: 10 * (i + 1) }));
  assert.deepEqual(added(ended).map(({ name }) => name), ["W1", "W2", "W3", "E", "W4"]);
});
