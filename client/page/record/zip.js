// A ZIP file of stored (uncompressed) entries, as a Blob that refers to its parts: nothing is copied into memory.

const LIMIT = 2 ** 32 - 1; // beyond it a ZIP file needs the 64-bit form

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let value = byte;
  for (let bit = 0; bit < 8; bit++) value = value & 1 ? (value >>> 1) ^ 0xedb88320 : value >>> 1;
  return value;
});

/** The CRC-32 of bytes; `before` is that of the bytes before them. */
export function crc32(bytes, before = 0) {
  let crc = ~before;
  for (let i = 0; i < bytes.length; i++) crc = (crc >>> 8) ^ TABLE[(crc ^ bytes[i]) & 0xff];
  return ~crc >>> 0;
}

/**
 * The ZIP file of entries `{name, blob, crc}`. The same entries and date (a Date) give the same bytes.
 * @throws {RangeError} when it would be 4 GiB or more.
 */
export function zip(entries, date) {
  const parts = [];
  const directory = [];
  let offset = 0;
  for (const { name, blob, crc } of entries) {
    const nameBytes = new TextEncoder().encode(name);
    const common = commonFields(date, crc, blob.size, nameBytes.length);
    const header = concatenated(little([0x04034b50, 4]), common, nameBytes);
    directory.push(
      little([0x02014b50, 4], [20, 2]),
      common,
      little([0, 2], [0, 2], [0, 2], [0, 4], [offset, 4]),
      nameBytes,
    );
    parts.push(header, blob);
    offset += header.length + blob.size;
  }
  const central = concatenated(...directory);
  if (offset + central.length + 22 > LIMIT) throw new RangeError("A recording can be 4 GiB at most.");
  const count = entries.length;
  const end = little([0x06054b50, 4], [0, 2], [0, 2], [count, 2], [count, 2], [central.length, 4], [offset, 4], [0, 2]);
  return new Blob([...parts, central, end], { type: "application/zip" });
}

/** What local header and central directory have in common: version, flags (UTF-8), method, time, date, CRC, sizes, lengths. */
function commonFields(date, crc, size, nameLength) {
  const time = (date.getUTCHours() << 11) | (date.getUTCMinutes() << 5) | (date.getUTCSeconds() >> 1);
  const day = ((date.getUTCFullYear() - 1980) << 9) | ((date.getUTCMonth() + 1) << 5) | date.getUTCDate();
  return little(
    [20, 2],
    [0x0800, 2],
    [0, 2],
    [time, 2],
    [day, 2],
    [crc, 4],
    [size, 4],
    [size, 4],
    [nameLength, 2],
    [0, 2],
  );
}

/** Numbers as little-endian bytes; each is given with its length, 2 or 4. */
function little(...numbers) {
  const view = new DataView(new ArrayBuffer(numbers.reduce((sum, [, length]) => sum + length, 0)));
  let at = 0;
  for (const [number, length] of numbers) {
    if (length === 2) view.setUint16(at, number, true);
    else view.setUint32(at, number, true);
    at += length;
  }
  return new Uint8Array(view.buffer);
}

function concatenated(...arrays) {
  const whole = new Uint8Array(arrays.reduce((sum, array) => sum + array.length, 0));
  let at = 0;
  for (const array of arrays) {
    whole.set(array, at);
    at += array.length;
  }
  return whole;
}
