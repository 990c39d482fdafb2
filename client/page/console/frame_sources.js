// Where pictures come from: a file, this device's camera, a video. Each gives `{image, width, height}` to be drawn, and
// of a film with the time at which it was taken.

import { openCamera } from "../record/camera.js";
import { h } from "../shared/dom.js";
import { t } from "../shared/text.js";

const LONG_SIDE = 640; // px, of frames of films
const JPEG_QUALITY = 0.85;
const VIDEO_STEP_S = 0.1; // of a video's time, from one frame to the next
const FAR_S = 1e7; // later than any video ends

/** `{blob, source, name}`: what is sent, a JPEG or PNG, what is drawn, and the file that holds it. */
export async function readPicture(file) {
  let image;
  try {
    image = await createImageBitmap(file);
  } catch {
    throw new Error(t`This file is not a picture that the browser can read.`);
  }
  const source = { image, width: image.width, height: image.height };
  const isSent = /^image\/(jpeg|png)$/.test(file.type);
  const name = isSent ? file.name : file.name.replace(/(\.[^.]*)?$/, ".jpg");
  return { blob: isSent ? file : await jpeg(source), source, name };
}

/** A picture as a JPEG. */
export function jpeg({ image, width, height }, canvas = h("canvas", { width, height })) {
  canvas.getContext("2d").drawImage(image, 0, 0, width, height);
  return new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", JPEG_QUALITY));
}

/**
 * The frames of this device's camera, each as it is asked for: `{blob, source, time}`. The camera has the map camera's
 * shape where it can: that of the recorder, if it is the same phone.
 */
export async function* cameraFrames({ camera }, signal) {
  if (!navigator.mediaDevices) throw new Error(t`The camera needs HTTPS: start the server with rholoc serve --tls.`);
  const [height, width] = [camera.width, camera.height].sort((a, b) => a - b);
  const stream = await openCamera(width, height);
  const video = h("video", { playsinline: true, muted: true });
  try {
    video.srcObject = stream;
    video.muted = true;
    await video.play();
    const canvas = h("canvas");
    while (!signal.aborted) {
      yield { ...(await frameOf(video, canvas)), time: performance.now() / 1000 };
      await new Promise(requestAnimationFrame); // draws, and lets a tab in the background rest
    }
  } finally {
    for (const track of stream.getTracks()) track.stop();
  }
}

/** The frames of a video file, ten a second of its time, however long each takes: `{blob, source, time}`. */
export async function* videoFrames(file, signal) {
  const video = h("video", { playsinline: true, muted: true, preload: "auto" });
  const address = URL.createObjectURL(file);
  try {
    video.muted = true;
    video.src = address;
    await once(video, "loadeddata");
    const canvas = h("canvas");
    const length = await lengthOf(video);
    for (let time = 0; time < length && !signal.aborted; time += VIDEO_STEP_S) {
      await seek(video, time);
      yield { ...(await frameOf(video, canvas)), time };
      await new Promise(requestAnimationFrame);
    }
  } finally {
    video.removeAttribute("src");
    URL.revokeObjectURL(address);
  }
}

/** Seconds. A browser that records a video does not write how long it is: its end is looked for. */
async function lengthOf(video) {
  if (Number.isFinite(video.duration)) return video.duration;
  await seek(video, FAR_S);
  return Number.isFinite(video.duration) ? video.duration : video.currentTime;
}

async function seek(video, time) {
  if (video.currentTime === time) return;
  video.currentTime = time;
  await once(video, "seeked");
}

function once(video, event) {
  return new Promise((resolve, reject) => {
    video.addEventListener(event, resolve, { once: true });
    const fail = () => reject(new Error(t`This file is not a video that the browser can play.`));
    video.addEventListener("error", fail, { once: true });
  });
}

/** What a video shows now, made smaller: `{blob, source}`. */
export async function frameOf(video, canvas) {
  const scale = Math.min(1, LONG_SIDE / Math.max(video.videoWidth, video.videoHeight));
  const [width, height] = [video.videoWidth, video.videoHeight].map((size) => Math.round(scale * size));
  Object.assign(canvas, { width, height });
  return { blob: await jpeg({ image: video, width, height }, canvas), source: { image: canvas, width, height } };
}
