// A picture's intrinsics, of what is known of the camera that took it.

import { camera as ofPart } from "../../js/poses.js";

const SAME_SHAPE = 0.01; // by how much two aspect ratios of one shape differ at most

/** How far the intrinsics of a picture are known. */
export const Known = Object.freeze({
  MEASURED: "measured", // a camera of the picture's own shape
  ASSUMED: "assumed", // the camera in another mode: turned, or cropped
  TYPED: "typed", // someone's word for the field of view
  ESTIMATED: "estimated", // by the server, of the picture
});

/**
 * @typedef {{known: string, fx: number, fy: number, cx: number, cy: number, distortion: number[], lens?: string}}
 *   Intrinsics
 */

/**
 * The intrinsics of a picture of `width` × `height` px, taken to be the given camera's: `{known, fx, fy, cx, cy,
 * distortion}`.
 *
 * A picture of the camera's own shape is only scaled. One of another shape is taken for a crop, or for more of what a
 * crop left out: phones and webcams cut their pictures above and below, so that the long sides show the same angle. A
 * picture that stands where the camera's lies is the camera turned.
 * @returns {Intrinsics}
 */
export function intrinsicsFor(camera, width, height) {
  const turned = width >= height !== camera.width >= camera.height;
  const own = turned ? quarterTurn(camera) : camera;
  const scale = Math.max(width, height) / Math.max(own.width, own.height);
  const sameShape = Math.abs((width / height) * (own.height / own.width) - 1) <= SAME_SHAPE;
  const part = { width: width / scale, height: height / scale };
  const crop = { ...part, x: (own.width - part.width) / 2, y: (own.height - part.height) / 2 };
  return {
    distortion: [],
    ...ofPart(own, { crop, width, height }),
    known: sameShape && !turned ? Known.MEASURED : Known.ASSUMED,
  };
}

/**
 * Of a typed horizontal field of view.
 * @returns {Intrinsics}
 */
export function intrinsicsOfFieldOfView(degrees, width, height) {
  const f = width / 2 / Math.tan((degrees * Math.PI) / 360);
  return { known: Known.TYPED, fx: f, fy: f, cx: (width - 1) / 2, cy: (height - 1) / 2, distortion: [] };
}

/**
 * The camera turned by a quarter. Which way is not known: the principal point is put into the middle, and tangential
 * distortion, which would change with the way, is left out.
 */
function quarterTurn({ width, height, fx, fy, distortion = [], lens }) {
  const [k1 = 0, k2 = 0, , , ...more] = distortion;
  const isRound = lens === "fisheye"; // its distortion is the same in all directions
  return {
    width: height,
    height: width,
    fx: fy,
    fy: fx,
    cx: (height - 1) / 2,
    cy: (width - 1) / 2,
    distortion: distortion.length && !isRound ? [k1, k2, 0, 0, ...more] : distortion,
    lens,
  };
}

/** As the query of a request. */
export function asQuery({ fx, fy, cx, cy, distortion, lens = "pinhole" }) {
  const figures = Object.fromEntries(
    Object.entries({ fx, fy, cx, cy }).map(([name, value]) => [name, value.toFixed(3)]),
  );
  const bent = distortion.length ? { distortion: distortion.join(",") } : {};
  return { ...figures, ...bent, ...(lens === "pinhole" ? {} : { lens }) };
}

/**
 * How far the picture's edges reach on the plane one metre in front of the camera: `[x, y]`; of wide lenses the part up
 * to 57° off the axis.
 */
export function halfExtents({ fx, fy, lens = "pinhole" }, width, height) {
  const reach = (share) => (lens === "pinhole" ? share : Math.tan(Math.min(share, 1)));
  return [reach(width / 2 / fx), reach(height / 2 / fy)];
}
