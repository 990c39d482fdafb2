// From what was stored to rholoc's own recording format: the files of maps/README.md in one ZIP file.

import { videoName } from "./camera.js";
import { clockTimes } from "./clock.js";
import { frameTimes } from "./container.js";
import { R_camera_imu } from "./motion.js";
import { cameraJson, framesCsv, imuCsv, waypointsCsv } from "./tables.js";
import { complete, FEWEST } from "./waypoints.js";
import { crc32, zip } from "./zip.js";

export const SHORTEST_S = 5; // that a map can come of

/** The video of stored parts. */
export function videoOf(recording, parts) {
  return new Blob(
    parts.map((part) => part.video),
    { type: recording.type },
  );
}

/** The ZIP file of a recording: the same bytes each time, as long as its description and parts are the same. */
export async function archive(recording, parts) {
  const video = {
    name: videoName(recording.type),
    blob: videoOf(recording, parts),
    crc: await checksum(parts.map((part) => part.video)),
  };
  const texts = Object.entries(await tables(recording, parts, video.blob)).map(([name, text]) => {
    const bytes = new TextEncoder().encode(text);
    return { name, blob: new Blob([bytes]), crc: crc32(bytes) };
  });
  return zip([video, ...texts], new Date(recording.created));
}

/** The files beside the video, by name. All times are seconds after the first frame. */
async function tables(recording, parts, video) {
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
  return {
    ...(times && { "frames.csv": framesCsv(times.map((time) => time - origin)) }),
    ...(rows.length && { "imu.csv": imuCsv(rows) }),
    ...(waypoints.length >= FEWEST && { "waypoints.csv": waypointsCsv(waypoints) }),
    "camera.json": cameraJson({ R_camera_imu: recording.facesAway ? R_camera_imu(recording.screenAngle) : null }),
  };
}

async function checksum(blobs) {
  let crc = 0;
  for (const blob of blobs) crc = crc32(new Uint8Array(await blob.arrayBuffer()), crc);
  return crc;
}
