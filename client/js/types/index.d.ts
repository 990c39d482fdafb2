// Written by client/js/write_types.py: run `make format`.
export { MapSession } from "./session.js";
export { Client, path, RholocError } from "./client.js";
export { Axes, camera, cameraOfProjection, carried, inverse, multiply, toOpenCV, turned } from "./poses.js";
