// What was recorded, in the browser's database until the server has it. Two tables: `recordings`, a description each, and
// `parts`, about a second each: `{recording, index, video: Blob, imu: rows, frames: times}`.

/** Where a recording stands. */
export const State = Object.freeze({
  RECORDING: "recording", // parts are still coming; after a reload: broken off, and as good as stopped
  STOPPED: "stopped", // for review; waypoints may change
  SENDING: "sending", // it does not change any more, and is being uploaded
  UPLOADED: "uploaded", // the server has it; its parts are gone
});

const NAME = "rholoc-recorder";

/** The phone's storage is full. */
export class StorageFull extends Error {}

/** The recordings in this browser; opened with `Store.open()`. */
export class Store {
  constructor(database) {
    this.database = database;
  }

  static async open() {
    const opening = indexedDB.open(NAME, 1);
    opening.onupgradeneeded = () => {
      opening.result.createObjectStore("recordings", { keyPath: "id" });
      opening.result.createObjectStore("parts", { keyPath: ["recording", "index"] });
    };
    return new Store(await done(opening));
  }

  /** All recordings' descriptions, the newest first. */
  async recordings() {
    const all = await done(this.table("recordings").getAll());
    return all.sort((a, b) => b.created - a.created);
  }

  /** One description, or undefined. */
  recording(id) {
    return done(this.table("recordings").get(id));
  }

  /** Keep a description in place of the one with its id; where storage is full, the old one stays. Returns the new one. */
  async save(recording) {
    try {
      await this.write((table) => table("recordings").put(recording));
    } catch (error) {
      if (!(error instanceof StorageFull)) throw error;
    }
    return recording;
  }

  /** Keep one more part of a recording, and its description with it. */
  async add(recording, part) {
    await this.write((table) => {
      table("parts").put({ recording: recording.id, ...part });
      table("recordings").put(recording);
    });
  }

  /** A recording's parts, in order. */
  parts(id) {
    return done(this.table("parts").getAll(IDBKeyRange.bound([id], [id, []])));
  }

  /** Remove one part of a recording. */
  async removePart(id, index) {
    await this.write((table) => table("parts").delete([id, index]));
  }

  /** Remove a recording's parts, and keep its description. */
  async dropParts(recording) {
    await this.write((table) => {
      table("parts").delete(IDBKeyRange.bound([recording.id], [recording.id, []]));
      table("recordings").put(recording);
    });
  }

  /** Remove a recording. */
  async remove(id) {
    await this.write((table) => {
      table("parts").delete(IDBKeyRange.bound([id], [id, []]));
      table("recordings").delete(id);
    });
  }

  table(name) {
    return this.database.transaction(name).objectStore(name);
  }

  /** All or nothing. @throws {StorageFull} */
  async write(change) {
    const transaction = this.database.transaction(["recordings", "parts"], "readwrite", { durability: "strict" });
    try {
      await new Promise((resolve, reject) => {
        transaction.oncomplete = resolve;
        transaction.onabort = () => reject(transaction.error);
        change((name) => transaction.objectStore(name));
      });
    } catch (error) {
      if (error?.name === "QuotaExceededError")
        throw new StorageFull("This phone's storage is full.", { cause: error });
      throw error;
    }
  }
}

function done(request) {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}
