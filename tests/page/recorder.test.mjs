import assert from "node:assert/strict";
import { test } from "node:test";

import { mapNameOf } from "../../client/page/shared/name_choice.js";
import { advice, BAREST, brightness, Flaw, flaws, LEAST_SHARP, sharpness, texture } from "../../client/page/record/coaching.js";
import { Headings, SECTORS } from "../../client/page/record/headings.js";
import { agreeing, featuresOf, match, PlaceMemory } from "../../client/page/record/place_memory.js";
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

/** A wide wall of smooth speckles, the same for a seed; `view(x)` is what a camera sees of it. */
function wall(seed, width = 900) {
  const height = 135;
  let state = seed;
  const next = () => ((state = (Math.imul(state, 1103515245) + 12345) & 0x7fffffff) / 0x7fffffff) * 255;
  const columns = Math.ceil(width / 6) + 2;
  const coarse = Float32Array.from({ length: columns * (Math.ceil(height / 6) + 2) }, next);
  const at = (x, y) => {
    const [i, j] = [Math.floor(x / 6), Math.floor(y / 6)];
    const [u, v] = [x / 6 - i, y / 6 - j];
    const value = (a, b) => coarse[(j + b) * columns + i + a];
    return (1 - v) * ((1 - u) * value(0, 0) + u * value(1, 0)) + v * ((1 - u) * value(0, 1) + u * value(1, 1));
  };
  return (left, noise = 0) =>
    Float32Array.from({ length: 240 * height }, (_, i) => at(left + (i % 240), Math.floor(i / 240)) + noise * (next() / 255 - 0.5));
}
const seen = (view) => featuresOf(view, 240, 135);

test("a view is known again, moved and noisy, and another is not", () => {
  const [here, elsewhere] = [wall(1), wall(2)];
  const [a, b, c] = [seen(here(100)), seen(here(118, 12)), seen(elsewhere(100))];
  assert.ok(a.count > 60, String(a.count));
  assert.ok(agreeing(a, b, match(a, b)) > 0.5 * a.count);
  assert.ok(agreeing(a, c, match(a, c)) < 6);
});

test("a walk that comes back closes a loop, one that goes on closes none, and a camera at rest neither", () => {
  const view = wall(3, 1500);
  const walk = (places) => {
    const memory = new PlaceMemory();
    const found = places.map((place, second) => memory.see(seen(view(place, 8)), second));
    return { found, count: memory.count };
  };
  const there = Array.from({ length: 20 }, (_, i) => 60 * i);
  assert.deepEqual(walk(there).found.filter(Boolean), []);
  const back = walk([...there, ...there.slice(0, 18).reverse()]);
  assert.ok(back.found.slice(-3).every((one) => one !== null && one.since <= 3), JSON.stringify(back.found.slice(-4)));
  assert.equal(walk(Array(10).fill(0)).count, 1);
  assert.ok(back.count >= 6, String(back.count));
  assert.equal(new PlaceMemory().see(featuresOf(new Float32Array(240 * 135).fill(90), 240, 135), 0), null);
});

test("directions are counted from the gyroscope, to the right, however the phone is held", () => {
  const rates = { upright: [0, 9.8, 0, 0, -1, 0], lying: [9.8, 0, 0, -1, 0, 0] };
  for (const [held, row] of Object.entries(rates)) {
    const headings = new Headings();
    for (let i = 0; i <= 50; i++) headings.turn([i * (Math.PI / 100), ...row]); // a radian a second for a quarter turn
    assert.ok(Math.abs(headings.heading - Math.PI / 2) < 1e-6, held);
    assert.equal(headings.sector, SECTORS / 4);
    headings.look(1.5);
    assert.equal(headings.covered, 1);
    headings.turn([100, ...row]); // a gap says nothing
    assert.equal(headings.sector, SECTORS / 4);
  }
});

test("any title becomes a name that the service takes", () => {
  assert.equal(mapNameOf("Office 2nd floor"), "Office-2nd-floor");
  assert.equal(mapNameOf(" Büro (Straße é) "), "Buero-Strasse-e");
  assert.equal(mapNameOf("hall-2.b_"), "hall-2.b_");
  assert.equal(mapNameOf("会議室"), "");
  assert.equal(mapNameOf("x".repeat(99)).length, 64);
});
