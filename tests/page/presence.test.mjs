import assert from "node:assert/strict";
import { test } from "node:test";

import { presenceLines } from "../../client/page/console/presence_lines.js";

test("where a landmark may be seen from is a cone cut off at both ends", () => {
  const feature = { position: [1, 2, 3], direction: [0, 0.6, 0.8], half_angle_deg: 40, nearest: 0.5, farthest: 4 };
  const lines = presenceLines(feature);
  assert.equal(lines.length % 6, 0);
  for (let i = 0; i < lines.length; i += 3) {
    const away = lines.slice(i, i + 3).map((value, axis) => value - feature.position[axis]);
    const distance = Math.hypot(...away);
    assert.ok(Math.abs(distance - 0.5) < 1e-9 || Math.abs(distance - 4) < 1e-9);
    const along = away.reduce((sum, value, axis) => sum + value * feature.direction[axis], 0);
    assert.ok(along / distance > Math.cos((40.001 * Math.PI) / 180));
  }
});

test("a landmark that is seen from straight above has a cone, too", () => {
  const lines = presenceLines({
    position: [0, 0, 0],
    direction: [0, 0, 1],
    half_angle_deg: 30,
    nearest: 1,
    farthest: 2,
  });
  assert.ok(lines.every(Number.isFinite));
});
