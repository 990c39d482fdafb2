// Replays recorded pairs of a Unity session through MapSession, for test_unity.py.

import { readFile } from "node:fs/promises";
const [, , module, file] = process.argv;
const { Axes, MapSession } = await import(module);
let [nowMs, answer] = [0, null];
const events = [];
const session = new MapSession(async () => answer, {
  axes: Axes.UNITY, now: () => nowMs,
  onLocalized: () => events.push("localized"), onLost: () => events.push("lost"),
});
const rows = (numbers) => [0, 4, 8, 12].map((i) => numbers.slice(i, i + 4));
for (const one of JSON.parse(await readFile(file)).frames) {
  nowMs = 1000 * one.time_s;
  const variances = [1, 1, 1, 0, 0, 0].map((is, i) => is ? 0.01 ** 2 : 0.3 ** 2);
  answer = { ...one, covariance: variances.map((v, i) => variances.map((_, j) => i === j ? v : 0)), pose: { T_map_camera: rows(one.T_map_camera) } };
  await session.offer({ pose: rows(one.unity), picture: null, camera: {} });
  console.log(JSON.stringify([session.inMap(rows(one.unity))?.flat() ?? null, session.toSession([1, 2, 3])]));
}
console.log(JSON.stringify(events.join(" ")));
