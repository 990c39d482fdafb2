// tus 1.0: an upload in pieces, which goes on from the last byte that the server has.

import { ApiError, request, url } from "../shared/api.js";

const PIECE = 2 ** 21;
const VERSION = { "Tus-Resumable": "1.0.0" };
const PAUSES_S = [1, 2, 4, 8, 15, 30];
const PASSING = new Set([408, 409, 423, 429, 502, 503, 504]); // states of the server that pass by themselves
const GONE = new Set([404, 410]); // the upload expired, or the server lost it

/**
 * Send a Blob to `v1/recordings`, for as long as it takes; resolves to the id of its job.
 *
 * `location` is where an earlier try stands, or null. `hear` is called with `{sent}`, `{location}` when the upload has an
 * address to go on at, and `{waiting: Error}` while the server cannot be reached.
 * @throws {ApiError} when trying again would not help; AbortError.
 */
export async function upload(blob, { metadata, location, hear, signal }) {
  let failures = 0;
  for (;;) {
    try {
      location ??= await create(blob, metadata, hear, signal);
      let standing = await stand(location, signal);
      while (standing.offset < blob.size) {
        hear({ sent: standing.offset });
        standing = await send(location, blob, standing.offset, signal);
        failures = 0;
      }
      hear({ sent: blob.size });
      return standing.job;
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (location && GONE.has(error.status)) {
        location = null;
        hear({ location });
      } else if (error.code !== "unreachable" && !PASSING.has(error.status)) throw error;
      hear({ waiting: error });
      await pause(PAUSES_S[Math.min(failures++, PAUSES_S.length - 1)], signal);
    }
  }
}

/** Whether this browser may upload. A key is asked for where one is needed; a server that is away is no obstacle yet. */
export async function mayUpload() {
  try {
    await request("v1/recordings", { method: "OPTIONS" });
  } catch (error) {
    return error.status !== 401 && error.status !== 403;
  }
  return true;
}

async function create(blob, metadata, hear, signal) {
  const response = await request("v1/recordings", {
    method: "POST",
    headers: { ...VERSION, "Upload-Length": String(blob.size), "Upload-Metadata": encoded(metadata) },
    signal,
  });
  const location = new URL(response.headers.get("Location"), url("v1/recordings")).href;
  hear({ location });
  return location;
}

async function stand(location, signal) {
  return standing(await request(location, { method: "HEAD", headers: VERSION, signal }));
}

async function send(location, blob, offset, signal) {
  const response = await request(location, {
    method: "PATCH",
    headers: { ...VERSION, "Upload-Offset": String(offset), "Content-Type": "application/offset+octet-stream" },
    body: blob.slice(offset, offset + PIECE),
    signal,
  });
  return standing(response);
}

function standing({ headers }) {
  return { offset: Number(headers.get("Upload-Offset")), job: headers.get("Rholoc-Job") };
}

function encoded(metadata) {
  const base64 = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text)));
  return Object.entries(metadata)
    .map(([key, value]) => `${key} ${base64(value)}`)
    .join(",");
}

/** Wait, but no longer than until the connection is back. */
function pause(seconds, signal) {
  return new Promise((resolve, reject) => {
    const end = (settle) => () => {
      clearTimeout(timer);
      removeEventListener("online", back);
      signal?.removeEventListener("abort", stop);
      settle();
    };
    const back = end(resolve);
    const stop = end(() => reject(signal.reason));
    const timer = setTimeout(back, seconds * 1000);
    addEventListener("online", back);
    signal?.addEventListener("abort", stop);
  });
}
