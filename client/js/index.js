// What applications import.

export { Client, path, RholocError } from "./client.js";
export { Axes, camera, cameraOfProjection, carried, inverse, multiply, toOpenCV, turned } from "./poses.js";
export { MapSession } from "./session.js";
