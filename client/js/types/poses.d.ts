// Written by client/js/write_types.py: run `make format`.
/** The product of two transforms. */
export function multiply(A: any, B: any): any;
/** The inverse of a rigid transform. */
export function inverse(T: any): any[][];
/** A point that a transform takes to another frame. */
export function carried(T: number[][], [x, y, z]: Iterable<number>): number[];
/** The rotation of a quaternion x, y, z, w of any length, as three rows. */
export function rotationOf(quaternion: any): number[][];
/**
 * The pose of a camera in a session's frame, by the service's axes. A left-handed session becomes the right-handed one
 * whose z axis is turned round.
 * @param {number[][] | ArrayLike<number>} pose four rows, or sixteen numbers column by column, as WebXR and ARKit give them
 * @param {string} axes of {@link Axes}
 * @returns {number[][]} T_session_camera
 * @throws {RangeError} it is no rigid motion, or the axes are unknown
 */
export function toOpenCV(pose: number[][] | ArrayLike<number>, axes: string): number[][];
/**
 * The pose of the camera whose picture is another's, turned clockwise by quarters: phones give poses for the display, and
 * pictures as the sensor lies.
 */
export function turned(T_session_camera: any, quarters: any): any;
/**
 * The intrinsics of a picture that is cropped out of a sensor's, and then scaled.
 * @param {{crop?: {x: number, y: number, width: number, height: number}, width?: number, height?: number}} picture the part in
 *   pixels of the sensor, by default all; and the size that it was scaled to
 */
export function camera(sensor: {
    width: number;
    height: number;
    fx: number;
    fy: number;
    cx: number;
    cy: number;
}, { crop, ...scaled }?: {
    crop?: {
        x: number;
        y: number;
        width: number;
        height: number;
    };
    width?: number;
    height?: number;
}): {
    width: any;
    height: any;
    fx: number;
    fy: number;
    cx: number;
    cy: number;
};
/**
 * The intrinsics of a view's raw picture by the projection matrix of WebXR or OpenGL, for the picture with its first row at
 * the top.
 * @param {ArrayLike<number>} matrix sixteen numbers, column by column
 */
export function cameraOfProjection(matrix: ArrayLike<number>, width: number, height: number): {
    width: number;
    height: number;
    fx: number;
    fy: number;
    cx: number;
    cy: number;
};
/** The angle between two rotations, in radians. */
export function angleBetween(A: any, B: any): number;
/** The mean of rotations near each other: each three rows of at least three numbers, and its weight. */
export function meanRotation(rotations: any, weights: any): number[][];
/** How a framework lays its axes. */
export const Axes: Readonly<{
    /** Right-handed; the camera looks along z, x right, y down. */
    OPENCV: "opencv";
    /** Right-handed; the camera looks along −z, x right, y up: WebXR, ARKit, ARCore, three.js. */
    OPENGL: "opengl";
    /** Left-handed, y up; the camera looks along z, x right, y up: Unity. */
    UNITY: "unity";
}>;
