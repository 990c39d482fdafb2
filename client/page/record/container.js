// The times of the frames in what MediaRecorder writes: WebM and Matroska, fragmented MP4. One video track, no sound.

const WINDOW = 2 ** 20;

/**
 * When the frames of a video are shown, in seconds after the first, in order; null where the file is of another kind or
 * is damaged. A file that was cut off counts as far as it goes.
 */
export async function frameTimes(blob) {
  const bytes = new Bytes(blob);
  try {
    const start = await bytes.view(0, 8);
    const times =
      start.getUint32(0) === EBML
        ? await matroskaTimes(bytes)
        : start.getUint32(4) === box("ftyp")
          ? await mp4Times(bytes)
          : [];
    if (times.length === 0) return null;
    times.sort((a, b) => a - b);
    return times.map((time) => time - times[0]);
  } catch (error) {
    if (error instanceof RangeError) return null;
    throw error;
  }
}

/** A Blob read window by window. */
class Bytes {
  constructor(blob) {
    this.blob = blob;
    this.size = blob.size;
    this.start = 0;
    this.window = new ArrayBuffer(0);
  }

  /** A view of `length` bytes; RangeError beyond the end. */
  async view(offset, length) {
    if (offset + length > this.size) throw new RangeError("beyond the end");
    if (offset < this.start || offset + length > this.start + this.window.byteLength) {
      this.start = offset;
      this.window = await this.blob.slice(offset, offset + Math.max(WINDOW, length)).arrayBuffer();
    }
    return new DataView(this.window, offset - this.start, length);
  }
}

// Matroska (RFC 9559): elements of an id, a size and content, within one another.

const EBML = 0x1a45dfa3;
const TIMESTAMP_SCALE = 0x2ad7b1;
const TIMESTAMP = 0xe7;
const BLOCKS = new Set([0xa3, 0xa1]); // SimpleBlock, Block
const PARENTS = new Set([0x18538067, 0x1549a966, 0x1f43b675, 0xa0]); // Segment, Info, Cluster, BlockGroup

async function matroskaTimes(bytes) {
  const times = [];
  let scale = 1e-3; // seconds
  let cluster = 0;
  let at = 0;
  while (at + 2 <= bytes.size) {
    const head = await bytes.view(at, Math.min(12, bytes.size - at));
    const id = variableInteger(head, 0, false);
    const size = variableInteger(head, id.length, true);
    const content = at + id.length + size.length;
    at = PARENTS.has(id.value) ? content : content + size.value;
    if (at > bytes.size) break; // cut off
    if (id.value === TIMESTAMP_SCALE) scale = unsigned(await bytes.view(content, size.value)) * 1e-9;
    else if (id.value === TIMESTAMP) cluster = unsigned(await bytes.view(content, size.value));
    else if (BLOCKS.has(id.value)) {
      const track = variableInteger(await bytes.view(content, 1), 0, true);
      times.push((cluster + (await bytes.view(content + track.length, 2)).getInt16(0)) * scale);
    }
  }
  return times;
}

/** A number whose leading zero bits tell its length; sizes drop the bit that ends them. */
function variableInteger(view, at, dropMarker) {
  const first = view.getUint8(at);
  const length = Math.clz32(first) - 23;
  let value = dropMarker ? first & (0xff >> length) : first;
  for (let i = 1; i < length; i++) value = value * 256 + view.getUint8(at + i);
  return { value, length };
}

function unsigned(view) {
  let value = 0;
  for (let i = 0; i < view.byteLength; i++) value = value * 256 + view.getUint8(i);
  return value;
}

// MP4 (ISO/IEC 14496-12): boxes of a size, a type and content. Frames are in runs (trun) of fragments (moof).

const MP4_PARENTS = new Set(["moov", "trak", "mdia", "mvex", "moof", "traf"].map(box));

function box(type) {
  return new DataView(new TextEncoder().encode(type).buffer).getUint32(0);
}

async function mp4Times(bytes) {
  const times = [];
  const track = { timescale: 1, duration: 0, fragmentDuration: 0, decodeTime: 0 };
  let at = 0;
  while (at + 8 <= bytes.size) {
    const head = await bytes.view(at, 8);
    const type = head.getUint32(4);
    let [size, header] = [head.getUint32(0), 8];
    if (size === 1) [size, header] = [Number((await bytes.view(at + 8, 8)).getBigUint64(0)), 16];
    if (size === 0) size = bytes.size - at;
    if (size < header || (at + size > bytes.size && type !== box("mdat"))) break; // damaged or cut off
    const read = MP4_BOXES.get(type);
    if (read) read(await bytes.view(at + header, size - header), track, times);
    at += MP4_PARENTS.has(type) ? header : size;
  }
  return times;
}

const MP4_BOXES = new Map([
  [box("mdhd"), (view, track) => (track.timescale = view.getUint32(view.getUint8(0) === 1 ? 20 : 12))],
  [box("trex"), (view, track) => (track.duration = view.getUint32(12))],
  [box("tfhd"), readFragmentHeader],
  [box("tfdt"), readDecodeTime],
  [box("trun"), readRun],
]);

function readFragmentHeader(view, track) {
  const flags = view.getUint32(0) & 0xffffff;
  const at = 8 + (flags & 0x1 ? 8 : 0) + (flags & 0x2 ? 4 : 0);
  track.fragmentDuration = flags & 0x8 ? view.getUint32(at) : track.duration;
}

function readDecodeTime(view, track) {
  track.decodeTime = view.getUint8(0) === 1 ? Number(view.getBigUint64(4)) : view.getUint32(4);
}

function readRun(view, track, times) {
  const flags = view.getUint32(0) & 0xffffff;
  const has = (flag) => (flags & flag ? 4 : 0);
  let at = 8 + has(0x1) + has(0x4);
  for (let left = view.getUint32(4); left > 0; left--) {
    const duration = has(0x100) ? view.getUint32(at) : track.fragmentDuration;
    const composition = at + has(0x100) + has(0x200) + has(0x400);
    times.push((track.decodeTime + (has(0x800) ? view.getInt32(composition) : 0)) / track.timescale);
    track.decodeTime += duration;
    at = composition + has(0x800);
  }
}
