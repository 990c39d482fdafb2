// From what was stored to rholoc's own recording format: the files of maps/README.md in one ZIP file.

import { videoName } from "./camera.js";
import { clockTimes } from "./clock.js";
import { frameTimes } from "./container.js";
import { R_camera_imu } from "./motion.js";
import { State } from "./store.js";
import { cameraJson, framesCsv, imuCsv, waypointsCsv } from "./tables.js";
import { complete, FEWEST } from "./waypoints.js";
import { crc32, zip } from "./zip.js";

export const SHORTEST_S = 5; // that a map can come of

/** The video of stored parts. */
export function videoOf(recording, parts) {
  return new Blob(parts.map((part) => part.video), { type: recording.type });
}

/**
 * The recording's description with its tables settled: `files`, a text each, and the checksum of the video. All times are
 * seconds after the first frame.
 */
export async function sealed(recording, parts) {
  const video = videoOf(recording, parts);
  const recorded = await frameTimes(video);
  const seen = parts.flatMap((part) => part.frames);
  const times = recorded && clockTimes(recorded, seen, recording.started);
  const origin = times ? times[0] : recording.started;
  const last = times ? times.at(-1) - origin : recording.duration;
  const rows = parts.flatMap((part) => part.imu).map(([time, ...values]) => [time - origin, ...values]);
  const waypoints = complete(recording.waypoints).map(({ time, ...waypoint }) => ({
    ...waypoint,
    time: Math.min(Math.max(time - origin, 0), last),
  }));
  const files = {
    ...(times && { "frames.csv": framesCsv(times.map((time) => time - origin)) }),
    ...(rows.length && { "imu.csv": imuCsv(rows) }),
    ...(waypoints.length >= FEWEST && { "waypoints.csv": waypointsCsv(waypoints) }),
    "camera.json": cameraJson({ R_camera_imu: recording.facesAway ? R_camera_imu(recording.screenAngle) : null }),
  };
  return { ...recording, state: State.SEALED, files, videoCrc: await checksum(parts.map((part) => part.video)) };
}

/** The ZIP file of a sealed recording: the same bytes each time. */
export function archive(recording, parts) {
  const texts = Object.entries(recording.files).map(([name, text]) => {
    const bytes = new TextEncoder().encode(text);
    return { name, blob: new Blob([bytes]), crc: crc32(bytes) };
  });
  const video = { name: videoName(recording.type), blob: videoOf(recording, parts), crc: recording.videoCrc };
  return zip([video, ...texts], new Date(recording.created));
}

async function checksum(blobs) {
  let crc = 0;
  for (const blob of blobs) crc = crc32(new Uint8Array(await blob.arrayBuffer()), crc);
  return crc;
}
