// What applications import.

export { Client, RholocError } from "./client.js";
export { Axes, camera, cameraOfProjection, inverse, multiply, toOpenCV, turned } from "./poses.js";
export { MapSession } from "./session.js";
