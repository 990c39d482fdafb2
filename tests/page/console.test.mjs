import assert from "node:assert/strict";
import { test } from "node:test";

import { cameraAt, moved, nextWalk, sayFailures, sayPlace, summary } from "../../client/page/console/coverage_view.js";
import { fieldsOf } from "../../client/page/console/correct.js";
import { planOfGeoJson } from "../../client/page/console/floor_plan.js";
import { halfExtents, intrinsicsFor, intrinsicsOfFieldOfView, Known } from "../../client/page/console/intrinsics.js";
import { summary as landscapeInWords, heights } from "../../client/page/console/landscape_view.js";
import { learningText } from "../../client/page/console/learning.js";
import { grouped, matches } from "../../client/page/console/list_tools.js";
import { Motions } from "../../client/page/console/motions.js";
import { fittingDistance, lookAt, perspective, project } from "../../client/page/console/matrix.js";
import { multiply } from "../../client/js/poses.js";
import { clipped } from "../../client/page/console/plain_painter.js";
import { strokes } from "../../client/page/console/plan_lines.js";
import { sayPicked } from "../../client/page/console/scene.js";
import { apart, ellipsoid, secondViews, walk } from "../../client/page/console/scene_lines.js";
import { readScene } from "../../client/page/console/scene_data.js";
import { snippet } from "../../client/page/console/snippets.js";
import { errorAt, rightness } from "../../client/page/console/rightness.js";
import { bounds, placement } from "../../client/page/console/thumbnail.js";
import { doing, secondsLeft, timeLeft } from "../../client/page/shared/job_words.js";
import { Track } from "../../client/page/console/track.js";

const CAMERA = { width: 1280, height: 720, fx: 1040, fy: 1030, cx: 645, cy: 350, distortion: [0.1, -0.02, 0.001, 0.002] };
const near = (a, b, within = 1e-9) => assert.ok(Math.abs(a - b) <= within, `${a} is not ${b}`);

test("a picture of the camera's shape has its intrinsics, scaled about the middle", () => {
  const found = intrinsicsFor(CAMERA, 640, 360);
  assert.equal(found.known, Known.MEASURED);
  near(found.fx, 520);
  near(found.cx - 319.5, (645 - 639.5) / 2);
  assert.deepEqual(found.distortion, CAMERA.distortion);
});

test("a picture of another shape shows the same angle along its long side", () => {
  for (const [width, height] of [
    [640, 480],
    [480, 640],
    [320, 640],
  ]) {
    const found = intrinsicsFor(CAMERA, width, height);
    assert.equal(found.known, Known.ASSUMED);
    const long = width >= height ? found.fx : found.fy;
    near(Math.max(width, height) / long, 1280 / 1040);
  }
  assert.deepEqual(intrinsicsFor(CAMERA, 720, 1280).distortion, [0.1, -0.02, 0, 0]);
});

test("a field of view reaches from edge to edge", () => {
  const [x, y] = halfExtents(intrinsicsOfFieldOfView(90, 800, 600), 800, 600);
  near(x, 1);
  near(y, 0.75);
});

test("all words of a search must be found", () => {
  assert.ok(matches("Kitchen north", "NORTH kit"));
  assert.ok(matches("anything", ""));
  assert.ok(!matches("Kitchen", "kitchen south"));
});

test("a scene is read with its colours and without", () => {
  const numbers = new Uint32Array([1, 1]);
  const floats = new Float32Array([1, 2, 3, 0.5, 4, 5, 6, 1, 0, 0, 0]);
  const plain = new Blob([numbers, floats]);
  const coloured = new Blob([numbers, floats, new Uint8Array([9, 8, 7])]);
  return Promise.all([plain, coloured].map((blob) => blob.arrayBuffer())).then(([without, whole]) => {
    assert.equal(readScene(without).colours, null);
    assert.equal(readScene(whole).second, null);
    assert.deepEqual([...readScene(whole).colours], [9, 8, 7]);
    assert.deepEqual([...readScene(whole).views.subarray(0, 3)], [4, 5, 6]);
  });
});

test("a scene is read with the views of a second reconstruction, which drift from the map's", async () => {
  const views = [1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 1, 0, 0, 0, 3, 0, 0, 1, 0, 0, 0];
  const second = [1, 1, 0, Number.NaN, Number.NaN, Number.NaN, 3, 3, 0];
  const parts = [
    new Uint32Array([1, 3]),
    new Float32Array([9, 9, 9, 0.1, ...views]),
    new Uint8Array([9, 8, 7]),
    new Float32Array(second),
  ];
  const scene = readScene(await new Blob(parts).arrayBuffer());
  assert.deepEqual([...scene.second], second);
  assert.deepEqual([...walk(secondViews(scene.views, scene.second))], [1, 1, 0, 3, 3, 0]);
  assert.deepEqual([...apart(scene.views, scene.second)], [1, 0, 0, 1, 1, 0, 3, 0, 0, 3, 3, 0]);
});

const COVERAGE = {
  share_sufficient: 0.5, positions_sufficient: 1, sufficient: 60, origin: [1, 2, 1.5], step: 0.5, pitch_deg: 0,
  axes: [[1, 0, 0], [0, 1, 0]], headings_deg: [0, 90, 180, 270], cells: [[0, 0], [1, 0], [0, 1]],
  counts: [[60, 40, 10, 0], [0, 0, 0, 0], [1, 2, 3, 4]],
}; // biome-ignore format: a table

test("a place says whether it works", () => {
  assert.equal(sayPlace(COVERAGE, 0, 0, "m"), "At 1.00, 2.00 m, looking 0°: 60 landmarks in view; it works.");
  assert.match(sayPlace(COVERAGE, 0, 1, "m"), /looking 90°: 40 landmarks in view; it may fail/);
  assert.match(sayPlace(COVERAGE, 1, 2, "m"), /^At 1\.50, 2\.00 m.*it will fail/);
  assert.match(summary(COVERAGE), /60 landmarks or more in 50 % .* 100 % of the places/);
});

test("keys move to the neighbour, and turn", () => {
  assert.deepEqual(moved(COVERAGE, { cell: null, heading: 0 }, "ArrowLeft"), { cell: 0, heading: 0 });
  assert.deepEqual(moved(COVERAGE, { cell: 0, heading: 0 }, "ArrowRight"), { cell: 1, heading: 0 });
  assert.deepEqual(moved(COVERAGE, { cell: 0, heading: 0 }, "ArrowUp"), { cell: 2, heading: 0 });
  assert.equal(moved(COVERAGE, { cell: 0, heading: 0 }, "ArrowLeft"), null);
  assert.deepEqual(moved(COVERAGE, { cell: 0, heading: 3 }, "PageUp"), { cell: 0, heading: 0 });
  assert.equal(moved(COVERAGE, { cell: 0, heading: 0 }, "a"), null);
});

test("a camera stands in its cell and looks along its heading", () => {
  const T = cameraAt(COVERAGE, 1, 1);
  assert.deepEqual(T.map((row) => row[3]), [1.5, 2, 1.5, 1]);
  near(T[1][2], 1);
  near(T[2][1], -1); // down
});

test("the map from above has north up and one scale", () => {
  const landmarks = new Float32Array([0, 0, 0, 1, 4, 2, 0, 1]);
  const box = bounds({ landmarks, views: new Float32Array([5, 1, 0, 1, 0, 0, 0]) });
  assert.deepEqual(box, [[0, 5], [0, 2]]);
  const place = placement(box, 400, 300);
  const [[x0, y0], [x1, y1]] = [place(0, 0), place(5, 2)];
  near((x1 - x0) / 5, (y0 - y1) / 2);
  assert.ok(y1 < y0);
});

test("what is clicked is said in the map's unit", () => {
  assert.equal(sayPicked({ position: [1, 2, 3], deviation: 0.012 }, true), "Landmark at 1.00, 2.00, 3.00 m, known to 1.2 cm");
  assert.match(sayPicked({ view: 4, position: [0, 0, 0], heading: [0, 1, 0] }, false), /^Picture 5 .* looking 90°$/);
});

test("programs quote what is strange and take the key from outside", () => {
  const asked = {
    url: "http://127.0.0.1:8080/", map: "it's", query: { prior_position: "1,2,3", dof: "auto" },
    file: "my picture's.png", type: "image/png", withKey: true,
  }; // biome-ignore format: short
  const curl = snippet("curl", asked);
  assert.match(curl, /'@my picture'\\''s\.png'/);
  assert.match(curl, /prior_position=1,2,3&dof=auto'$/);
  assert.match(curl, /\$RHOLOC_API_KEY/);
  for (const language of ["python", "javascript"]) {
    assert.match(snippet(language, asked), /RHOLOC_API_KEY/);
    assert.doesNotMatch(snippet(language, { ...asked, withKey: false }), /RHOLOC_API_KEY/);
  }
});

test("the next walk goes to where most directions fail, and looks in them", () => {
  const works = [90, 90, 90, 90];
  const row = Array.from({ length: 9 }, (_, i) => [i, 0]);
  const coverage = { ...COVERAGE, cells: row, counts: row.map(([i]) => (i >= 6 ? [5, 90, 90, 90] : works)) };
  const { cell, degrees, position } = nextWalk(coverage);
  assert.ok(cell >= 6);
  near(Math.min(degrees, 360 - degrees), 0, 1e-6);
  near(position[0], 1 + 0.5 * cell);
  assert.equal(nextWalk({ ...coverage, counts: row.map(() => works) }), null);
});

const poseAt = (x) => [
  [0, 0, 1, x],
  [-1, 0, 0, 0],
  [0, -1, 0, 1.5],
  [0, 0, 0, 1],
];

test("the whole room just fills the picture, whatever its shape", () => {
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1 ? 6 : 0, i & 2 ? 3 : -1, i & 4 ? 2.5 : 0]);
  const target = [3, 1, 1.25];
  const away = [0.6, -0.5, Math.sqrt(1 - 0.61)];
  for (const [aspect, fov] of [[1.6, 0.9], [0.6, 1.2]]) {
    const far = fittingDistance(corners, target, away, fov, aspect, 0.9);
    const matrix = multiply(perspective(fov, aspect, 0.1, 100), lookAt(target.map((v, i) => v + far * away[i]), target));
    const reach = corners.flatMap((corner) => project(matrix, corner).slice(0, 2).map(Math.abs));
    near(Math.max(...reach), 0.9, 1e-5);
  }
});

test("who asks moves smoothly from answer to answer, and fades", () => {
  const motions = new Motions();
  const hear = (x, now) => motions.hear({ asker: "robot", T_map_camera: poseAt(x), localized: true }, now);
  const x = (now) => motions.now(now, 3, 30)[0].T[0][3];
  hear(0, 10);
  near(x(10), 0);
  hear(1, 10.2);
  near(x(10.2), 0);
  near(x(10.3), 0.5);
  near(x(10.4), 1);
  assert.ok(motions.moving(10.3));
  assert.ok(!motions.moving(11));
  near(motions.all(10.4, 30)[0].hertz, 5);
  assert.equal(motions.now(12, 3, 30)[0].stale, false);
  assert.equal(motions.now(14, 3, 30)[0].stale, true);
  assert.deepEqual(motions.now(50, 3, 30), []);
});

test("on the way a turned camera stays a camera", () => {
  const motions = new Motions();
  motions.hear({ asker: "robot", T_map_camera: poseAt(0), localized: true }, 0);
  const turned = [
    [1, 0, 0, 0],
    [0, 0, 1, 0],
    [0, -1, 0, 0],
    [0, 0, 0, 1],
  ];
  motions.hear({ asker: "robot", T_map_camera: turned, localized: true }, 1);
  const [{ T }] = motions.now(1.5, 3, 30);
  for (const j of [0, 1, 2]) near(Math.hypot(T[0][j], T[1][j], T[2][j]), 1);
  near(T[0][0] * T[0][2] + T[1][0] * T[1][2] + T[2][0] * T[2][2], 0);
});

test("failures are counted in a sentence", () => {
  const position = [0, 0, 0];
  const placed = [{ reason: null, position }, { reason: "deadline", position }];
  assert.match(sayFailures(placed), /without a pose: 1, with an unsure one: 1\. The drawing glows .* from\.$/);
  assert.match(sayFailures([{ reason: "deadline", position: null }]), /without a pose: 1, .*: 0\. Of 1 nobody knows where they/);
  assert.match(sayFailures([]), /No request failed/);
});

test("a landscape is drawn north up, dark to bright", () => {
  const { width, height, pixels } = heights([
    [0, 5],
    [10, 0],
  ]);
  assert.deepEqual([width, height], [2, 2]);
  const at = (row, column) => [...pixels.slice(4 * (2 * row + column), 4 * (2 * row + column) + 3)];
  assert.deepEqual(at(0, 0), [252, 253, 191]); // the most, of the greater y
  assert.deepEqual(at(1, 0), [0, 0, 4]);
  assert.deepEqual(at(1, 1), [183, 55, 121]);
});

test("a landscape says how wide it is and how much is gained", () => {
  const seen = { values: [[1, 2], [3, 4]], spacing: 0.5, ways: [{ gain_nats: 3 }, { gain_nats: 17.4 }], scale: "metric" };
  assert.match(landscapeInWords({ ...seen, localized: true }), /around the pose, 0\.5 m wide.* 2 ascents\.$/);
  assert.match(landscapeInWords({ ...seen, localized: false }), /^No pose/);
});

test("of a line what is in the picture is drawn, also where it begins behind the camera", () => {
  assert.deepEqual(clipped([0, 0, 2], [1, 1, 2]), [
    [0, 0, 2],
    [1, 1, 2],
  ]);
  assert.deepEqual(clipped([0, 0, 1], [4, 0, 1])[1], [1, 0, 1]);
  const [behind, before] = clipped([0, 0, -1], [0, 1, 3]);
  near(behind[1], behind[2]); // it comes in over the upper edge
  assert.deepEqual(before, [0, 1, 3]);
  assert.equal(clipped([2, 0, 1], [2, 5, 1]), null);
  assert.equal(clipped([-3, 0, 1], [0, 3, 1]), null); // past a corner
  assert.equal(clipped([0, 0, -1], [0, 0, -2]), null);
});

test("a list is grouped by name, what is in no group last, and what is in several in each", () => {
  const items = [{ tags: ["b", "a"] }, { tags: [] }, { tags: ["b", ""] }];
  assert.deepEqual(grouped(items, undefined), [{ title: null, items }]);
  assert.deepEqual(
    grouped(items, ({ tags }) => tags),
    [
      { title: "a", items: [items[0]] },
      { title: "b", items: [items[0], items[2]] },
      { title: "the others", items: [items[1]] },
    ],
  );
  assert.deepEqual(grouped([], () => ["a"]), []);
});

test("what stands out of a plan becomes strokes, row by row", () => {
  const grey = [255, 0, 0, 255, 255, 255, 255, 20];
  assert.deepEqual(strokes(Uint8Array.from(grey), 4, 2), [[1, 3, 0], [3, 4, 1]]);
});

test("an ellipsoid reaches two standard deviations along its axes", () => {
  const covariance = [[0.04, 0, 0], [0, 0.01, 0], [0, 0, 0.0025]];
  const lines = ellipsoid({ position: [1, 2, 3], covariance });
  const along = (axis) => lines.filter((_, i) => i % 3 === axis);
  const close = (a, b) => assert.ok(Math.abs(a - b) < 1e-9, `${a} ${b}`);
  [[0, 1, 0.4], [1, 2, 0.2], [2, 3, 0.1]].forEach(([axis, middle, reach]) => {
    close(Math.max(...along(axis)), middle + reach);
    close(Math.min(...along(axis)), middle - reach);
  });
});

test("a track is in pieces where it is lost and where it jumps", () => {
  const track = new Track();
  const says = (x, status = "tracking", reset_counter = 0) =>
    track.take({ status, reset_counter, answer: null, covariance: null, pose: { position: [x, 0, 0] } });
  track.take({ status: "searching", reset_counter: 0, answer: { localized: false }, pose: null });
  assert.equal(track.refused.localized, false);
  [0, 0.1].forEach((x) => says(x));
  [0.2, 0.3].forEach((x) => says(x, "lost"));
  says(1.3, "tracking", 1);
  says(1.4, "tracking", 1);
  assert.deepEqual(track.pieces.map(({ status }) => status), ["tracking", "lost", "tracking"]);
  assert.deepEqual(track.pieces.map(({ positions }) => positions.map(([x]) => x)), [[0, 0.1], [0.1, 0.2, 0.3], [1.3, 1.4]]);
  assert.deepEqual(track.jumps, [1]);
});

test("a map says from how many queries it learns, when it last did, and what came of it", () => {
  const none = { learns: false, queries: 0, fewest: 30, last: null, latest: null, job: null };
  assert.equal(learningText(none), null);
  const asked = { ...none, learns: true, queries: 12 };
  assert.equal(
    learningText(asked),
    "It learns from those who use it: 12 queries are kept. From 30 on it can learn.",
  );
  assert.match(learningText({ ...asked, learns: false }), /^It no longer learns .* 12 queries are kept\.$/);
  assert.match(learningText({ ...asked, queries: 40, job: "1f" }), /40 queries are kept\. It is learning now\.$/);
  const queries = { features_forgotten: 401, recall_before: 0.884, recall_after: 1 };
  const last = { version: 2, features_new: 1044, queries };
  const ended = Date.UTC(2026, 2, 1, 3, 10) / 1000;
  const learned = learningText({ ...asked, queries: 199, last, latest: { state: "published", ended } });
  assert.match(learned, /It last learned on 1 Mar 2026, .*: 1,044 landmarks are new, 401 are gone\./);
  assert.match(learned, /it placed 88 % before and 100 % after\.$/);
  const restored = learningText({ ...none, last });
  assert.match(restored, /^With version 2 it learned: 1,044 landmarks are new/);
  const error = { message: "The map would be worse." };
  const failed = learningText({ ...asked, last, latest: { state: "failed", ended, error } });
  assert.match(failed, /On 1 Mar 2026, .* it learned nothing: The map would be worse\. With version 2 it learned/);
});

test("a running job says what it does and how long that still takes", () => {
  const job = { state: "running", stage: "poses", message: "", started: 1000, progress: 0.4 };
  assert.equal(doing(job), "Finding where each picture was taken"); // a line is never empty
  assert.equal(doing({ ...job, message: "31 of 60 keyframes placed" }), "31 of 60 keyframes placed");
  const takenOver = { ...job, message: "waiting for another worker: its worker died" };
  assert.equal(doing(takenOver), "Finding where each picture was taken");
  assert.match(doing({ ...takenOver, state: "queued" }), /^waiting for another worker/);
  assert.equal(doing({ stage: "published", message: "published" }), "Published");
  near(secondsLeft(job, 1080), 120);
  assert.equal(timeLeft(job, 1080), "about 2 minutes left");
  assert.equal(timeLeft({ ...job, progress: 0.9 }, 1080), "less than a minute left");
  assert.equal(timeLeft({ ...job, progress: 0.5 }, 1060), "about a minute left");
  assert.equal(timeLeft({ ...job, progress: 0.05 }, 1900), "about 5 hours left");
  for (const unknown of [{ state: "queued" }, { state: "published" }, { started: null }, { progress: 0.01 }, { started: 2000 }])
    assert.equal(timeLeft({ ...job, ...unknown }, 1080), "");
});

test("a place is as right as the views near it", () => {
  const views = Float32Array.from([0, 0, 1, 1, 0, 0, 0, 4, 0, 1, 1, 0, 0, 0, 4, 0.2, 1, -1, 0, 0, 0]);
  const errors = [0.01, 0.04, 0.04];
  assert.equal(rightness(views, errors, [0.1, 0], 5).view, 0);
  assert.ok(Math.abs(rightness(views, errors, [0.1, 0], 5).error - 0.01) < 1e-3);
  assert.equal(rightness(views, errors, [4, 0.1], 180).view, 2);
  assert.ok(Math.abs(errorAt(views, errors, 4, 0) - 0.04) < 1e-3);
  assert.equal(errorAt(views, errors, 4, 9), null);
  assert.equal(errorAt(views, [null, null, null], 4, 0), null);
});

test("a plan of GeoJSON has the size that the ellipsoid gives it", () => {
  const ring = [[13.405, 52.52], [13.407, 52.52], [13.407, 52.521], [13.405, 52.521], [13.405, 52.52]];
  const plan = planOfGeoJson(JSON.stringify({ type: "Polygon", coordinates: [ring] }));
  // geodesics of WGS 84 by pyproj: along the parallel of the middle, and along a meridian
  assert.ok(Math.abs(plan.width - 135.75728) < 1e-4, plan.width);
  assert.ok(Math.abs(plan.height - 111.27722) < 1e-4, plan.height);
});

test("fields that are typed become numbers, true and false, and text", () => {
  assert.deepEqual(fieldsOf("seats=12, owner=Ada Lovelace,open = true, code=a=b, note="), {
    seats: 12, owner: "Ada Lovelace", open: true, code: "a=b", note: "",
  });
  assert.deepEqual(fieldsOf(" , "), {});
});
