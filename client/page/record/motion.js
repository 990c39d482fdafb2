// What the phone's inertial sensors say. Axes are the device's: x right, y up, z out of the screen, upright in the hand.

const RADIANS = Math.PI / 180;

/**
 * A row of Table 3 of a DeviceMotionEvent: [time, ax, ay, az, gx, gy, gz] in s, m/s², rad/s; null where a sensor is
 * missing. `sign` is what acceleration is multiplied with, see `accelerationSign`.
 */
export function motionRow({ timeStamp, accelerationIncludingGravity: a, rotationRate: w }, sign = 1) {
  const values = [a?.x, a?.y, a?.z, w?.alpha, w?.beta, w?.gamma]; // alpha, beta, gamma are about x, y, z
  if (!values.every(Number.isFinite)) return null;
  return [timeStamp / 1000, ...values.map((value, i) => value * (i < 3 ? sign : RADIANS))];
}

/** Which sensors a DeviceMotionEvent does not speak of. */
export function missingSensors({ accelerationIncludingGravity: a, rotationRate: w }) {
  return [!Number.isFinite(a?.x) && "accelerometer", !Number.isFinite(w?.alpha) && "gyroscope"].filter(Boolean);
}

/** The upward direction in the device's axes, of a DeviceOrientationEvent's angles in degrees. */
export function upward({ beta, gamma }) {
  const [b, g] = [beta * RADIANS, gamma * RADIANS];
  return [-Math.cos(b) * Math.sin(g), Math.sin(b), Math.cos(b) * Math.cos(g)];
}

/**
 * 1 where the accelerometer reads upwards at rest, as the standard says, -1 where it reads downwards, as iPhones do.
 * 0 while the two directions are too far from parallel to tell.
 */
export function accelerationSign({ x, y, z }, up) {
  const along = (x * up[0] + y * up[1] + z * up[2]) / Math.hypot(x, y, z);
  return Math.abs(along) > 0.7 ? Math.sign(along) : 0;
}

/** Events a second, of their times in seconds; 0 of fewer than two. */
export function rate(times) {
  const span = times.at(-1) - times[0];
  return span > 0 ? (times.length - 1) / span : 0;
}

/**
 * From the device's axes to those of the camera on its back (x right, y down, z forward), in pictures that are turned
 * upright while the screen is turned by `screenAngle` degrees.
 */
export function R_camera_imu(screenAngle) {
  const [c, s] = [Math.round(Math.cos(screenAngle * RADIANS)), Math.round(Math.sin(screenAngle * RADIANS))];
  return [
    [c, -s, 0],
    [-s, -c, 0],
    [0, 0, -1],
  ].map((row) => row.map((value) => value + 0)); // no negative zeros
}
