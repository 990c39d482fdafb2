// What to tell someone who is recording, while there is time to do better.

export const LEAST_RATE_HZ = 25; // of the inertial sensors
export const FASTEST_TURN_DEG_S = 50; // above it the picture blurs and neighbouring frames share too little
export const DARKEST = 0.16; // mean brightness, 0 to 1; below it the camera blurs and adds noise
export const MOST_ROLL_DEG = 15;
const LEAST_UPRIGHT = 0.35; // of gravity within the screen's plane; below it the phone lies flat and has no roll

/**
 * How far the picture is rolled, in degrees, clockwise positive, from the acceleration [ax, ay, az] in the device's axes;
 * null while the phone lies flat.
 */
export function rollDegrees([ax, ay, az], screenAngle = 0) {
  const turn = (screenAngle * Math.PI) / 180;
  const right = Math.cos(turn) * ax - Math.sin(turn) * ay;
  const up = Math.sin(turn) * ax + Math.cos(turn) * ay;
  if (Math.hypot(right, up) < LEAST_UPRIGHT * Math.hypot(ax, ay, az)) return null;
  return (-Math.atan2(right, up) * 180) / Math.PI;
}

/** How fast the phone turns, in degrees a second: the mean over rows of Table 3; 0 without any. */
export function turnRate(rows) {
  const sum = rows.reduce((total, [, , , , gx, gy, gz]) => total + Math.hypot(gx, gy, gz), 0);
  return rows.length ? (sum / rows.length) * (180 / Math.PI) : 0;
}

/** The mean brightness, 0 to 1, of RGBA pixels. */
export function brightness(rgba) {
  let sum = 0;
  for (let i = 0; i < rgba.length; i += 4) sum += 0.299 * rgba[i] + 0.587 * rgba[i + 1] + 0.114 * rgba[i + 2];
  return sum / (rgba.length / 4) / 255;
}

/**
 * The one most urgent advice, `{code, text}`, or null when all is well. Each measurement may be null where unknown.
 * @param {{turnDegS: ?number, light: ?number, rollDeg: ?number, imuHz: ?number}} measured
 */
export function advice({ turnDegS, light, rollDeg, imuHz }) {
  if (turnDegS > FASTEST_TURN_DEG_S) return { code: "too-fast", text: "Too fast. Turn more slowly." };
  if (light !== null && light < DARKEST) return { code: "too-dark", text: "Too dark. Turn on a light." };
  if (Math.abs(rollDeg) > MOST_ROLL_DEG) return { code: "not-upright", text: "Hold the phone upright." };
  if (imuHz !== null && imuHz < LEAST_RATE_HZ)
    return { code: "slow-sensors", text: `The motion sensors report ${Math.round(imuHz)} times a second; ${LEAST_RATE_HZ} are needed.` };
  return null;
}
