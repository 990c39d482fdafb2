// Replays recorded pairs of a session's poses and answers through MapSession: a line for each frame, then the events.

import { readFile } from "node:fs/promises";

const [, , module, file] = process.argv;
const { MapSession } = await import(module);
const { axes, intervalMs, frames } = JSON.parse(await readFile(file));
let [nowMs, answer] = [0, null];
const events = [];
const session = new MapSession(async () => answer, {
  axes,
  intervalMs,
  now: () => nowMs,
  onLocalized: () => events.push("localized"),
  onLost: () => events.push("lost"),
});
const rows = (numbers) => [0, 4, 8, 12].map((i) => numbers.slice(i, i + 4));
const VARIANCES = [...Array(3).fill(0.01 ** 2), ...Array(3).fill(0.3 ** 2)];
const covariance = VARIANCES.map((variance, i) => VARIANCES.map((_, j) => (i === j ? variance : 0)));
for (const { time_s, session_pose, T_map_camera, localized, recognized } of frames) {
  nowMs = 1000 * time_s;
  const pose = rows(session_pose);
  if (T_map_camera) {
    answer = { localized, recognized, covariance, pose: { T_map_camera: rows(T_map_camera) } };
    await session.offer({ pose, picture: null, camera: {} });
  }
  console.log(JSON.stringify([session.inMap(pose)?.flat() ?? null, session.toSession([1, 2, 3])]));
}
console.log(JSON.stringify(events.join(" ")));
