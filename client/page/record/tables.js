// The text files of a recording, as maps/README.md describes them. Times are seconds.

/** `imu.csv`, the paper's Table 3, of rows [time, ax, ay, az, gx, gy, gz] in s, m/s², rad/s. */
export function imuCsv(rows) {
  return csv("timestamp,ax,ay,az,gx,gy,gz", rows, ([time, ...values]) => [seconds(time), ...values.map(digits)]);
}

/** `frames.csv` of the frames' times. */
export function framesCsv(times) {
  return csv("frame,timestamp", times, (time, number) => [number, seconds(time)]);
}

/** `waypoints.csv` of `{name, time, position: [x, y, z]}`. */
export function waypointsCsv(waypoints) {
  return csv("name,time,x,y,z", waypoints, ({ name, time, position }) => [quoted(name), seconds(time), ...position]);
}

/** `camera.json` of a device whose accelerometer feels gravity; `R_camera_imu` may be null. */
export function cameraJson({ R_camera_imu }) {
  const known = { gravity_included: true, ...(R_camera_imu && { R_camera_imu }) };
  return `${JSON.stringify(known, null, 2)}\n`;
}

function csv(header, rows, cells) {
  return `${[header, ...rows.map((row, number) => cells(row, number).join(","))].join("\n")}\n`;
}

const seconds = (time) => time.toFixed(6);
const digits = (value) => Number(value.toPrecision(9));
const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
