// What to say to someone who is recording, while there is time to do better.

import { t } from "../shared/text.js";

export const LEAST_RATE_HZ = 25; // of the inertial sensors
export const FASTEST_TURN_DEG_S = 50; // above it the picture blurs and neighbouring frames share too little
export const DARKEST = 0.16; // mean brightness, 0 to 1; below it the camera blurs and adds noise
export const BAREST = 0.12; // share of the picture that shows texture; below it nothing can be recognised
export const LEAST_SHARP = 0.45; // of `sharpness`; a blur of 6 px in 640 is at 0.36, pictures of real walks from 0.62 on
export const MOST_ROLL_DEG = 15;
export const LONGEST_STAND_S = 6; // without a new view; at a measured point one stands for two
const LEAST_UPRIGHT = 0.35; // of gravity within the screen's plane; below it the phone lies flat and has no roll
const BLOCK = 8; // px, of the squares that texture is looked for in
const LEAST_CONTRAST = 24; // grey levels within a block, of 255; sensor noise in a bare wall stays below

/** What is wrong with a moment of a walk. */
export const Flaw = Object.freeze({
  TOO_FAST: "too-fast",
  TOO_DARK: "too-dark",
  BLURRED: "blurred",
  BARE: "bare",
});

const ADVICE = {
  [Flaw.TOO_FAST]: t`Too fast. Turn more slowly.`,
  [Flaw.TOO_DARK]: t`Too dark. Turn on a light.`,
  [Flaw.BLURRED]: t`Blurred. Slow down, or wipe the lens.`,
  [Flaw.BARE]: t`Nothing to recognise here. Turn to something with texture, or step back.`,
};

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

/** RGBA pixels → grey levels, 0 to 255. */
export function greyLevels(rgba) {
  return Float32Array.from(
    { length: rgba.length / 4 },
    (_, i) => 0.299 * rgba[4 * i] + 0.587 * rgba[4 * i + 1] + 0.114 * rgba[4 * i + 2],
  );
}

/** The mean brightness, 0 to 1, of grey levels. */
export function brightness(grey) {
  return grey.reduce((sum, value) => sum + value, 0) / grey.length / 255;
}

/** The share of a picture's blocks, 0 to 1, that show more contrast than a bare wall. */
export function texture(grey, width, height) {
  let [textured, blocks] = [0, 0];
  for (let top = 0; top + BLOCK <= height; top += BLOCK) {
    for (let left = 0; left + BLOCK <= width; left += BLOCK) {
      let [darkest, lightest] = [255, 0];
      for (let y = top; y < top + BLOCK; y++) {
        for (let x = left; x < left + BLOCK; x++) {
          const value = grey[y * width + x];
          if (value < darkest) darkest = value;
          if (value > lightest) lightest = value;
        }
      }
      blocks++;
      if (lightest - darkest > LEAST_CONTRAST) textured++;
    }
  }
  return blocks ? textured / blocks : 0;
}

/**
 * How sharp a picture's edges are, 0 to 1: of how grey levels change over four pixels, the part that they change within
 * one, where they change most. A picture without edges has no sharpness: null.
 */
export function sharpness(grey, width, height) {
  const steps = [];
  for (let y = 2; y < height - 2; y += 2) {
    for (let x = 2; x < width - 2; x += 2) {
      const at = y * width + x;
      const across = Math.abs(grey[at + 2] - grey[at - 2]);
      const down = Math.abs(grey[at + 2 * width] - grey[at - 2 * width]);
      const stride = across > down ? 1 : width;
      const wide = Math.max(across, down);
      if (wide <= LEAST_CONTRAST) continue;
      let steepest = 0;
      for (let k = -2; k < 2; k++)
        steepest = Math.max(steepest, Math.abs(grey[at + (k + 1) * stride] - grey[at + k * stride]));
      steps.push(Math.min(1, steepest / wide));
    }
  }
  if (!steps.length) return null;
  steps.sort((a, b) => a - b);
  return steps[steps.length >> 1];
}

/**
 * What is wrong with a moment, the worst first. Each measurement may be null where unknown.
 * @param {{turnDegS?: ?number, light?: ?number, texture?: ?number, sharpness?: ?number}} measured
 */
export function flaws({ turnDegS = null, light = null, texture = null, sharpness = null }) {
  return [
    turnDegS !== null && turnDegS > FASTEST_TURN_DEG_S && Flaw.TOO_FAST,
    light !== null && light < DARKEST && Flaw.TOO_DARK,
    texture !== null && texture < BAREST && Flaw.BARE,
    sharpness !== null && sharpness < LEAST_SHARP && Flaw.BLURRED,
  ].filter((flaw) => typeof flaw === "string");
}

/** The one most urgent advice, `{code, text}`, or null when all is well. */
export function advice({ rollDeg = null, imuHz = null, stoodS = 0, ...moment }) {
  const [flaw] = flaws(moment);
  if (flaw) return { code: flaw, text: ADVICE[flaw] };
  if (stoodS > LONGEST_STAND_S) return { code: "standing", text: t`Nothing new in view. Walk on.` };
  if (rollDeg !== null && Math.abs(rollDeg) > MOST_ROLL_DEG)
    return { code: "not-upright", text: t`Hold the phone upright.` };
  if (imuHz !== null && imuHz < LEAST_RATE_HZ)
    return {
      code: "slow-sensors",
      text: t`The motion sensors report ${Math.round(imuHz)} times a second; ${LEAST_RATE_HZ} are needed.`,
    };
  return null;
}
