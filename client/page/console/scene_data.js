// What `/v1/maps/{map}/scene` answers.

export const STRIDE_LANDMARK = 4; // x, y, z, standard deviation
export const STRIDE_VIEW = 7; // x, y, z, heading, walk

/** What `/v1/maps/{map}/points` answers: `{positions, colours}`, three numbers and three bytes for each point. */
export function readPoints(buffer) {
  const [count] = new Uint32Array(buffer, 0, 1);
  const positions = new Float32Array(buffer, 4, 3 * count);
  return { positions, colours: new Uint8Array(buffer, 4 + positions.byteLength, 3 * count) };
}

/**
 * What `/v1/maps/{map}/room` answers: `{positions, faces, colours}`, three numbers and three bytes for each vertex, four
 * vertices for each face.
 */
export function readRoom(buffer) {
  const [vertices, count] = new Uint32Array(buffer, 0, 2);
  const positions = new Float32Array(buffer, 8, 3 * vertices);
  const faces = new Uint32Array(buffer, 8 + positions.byteLength, 4 * count);
  const colours = new Uint8Array(buffer, 8 + positions.byteLength + faces.byteLength, 3 * vertices);
  return { positions, faces, colours };
}

/**
 * `{features, landmarks, views, colours, second}`: the number of landmarks, their figures, those of the views; three bytes for
 * each landmark, red, green and blue; three numbers for each view, its position in a second reconstruction, NaN where that has
 * none. Null where the map does not know them.
 */
export function readScene(buffer) {
  const [features, count] = new Uint32Array(buffer, 0, 2);
  const landmarks = new Float32Array(buffer, 8, features * STRIDE_LANDMARK);
  const views = new Float32Array(buffer, 8 + landmarks.byteLength, count * STRIDE_VIEW);
  const end = 8 + landmarks.byteLength + views.byteLength;
  const coloured = features > 0 && buffer.byteLength >= end + 3 * features;
  const checked = count > 0 && buffer.byteLength > end + 3 * features;
  return {
    features,
    landmarks,
    views,
    colours: coloured ? new Uint8Array(buffer, end, 3 * features) : null,
    second: checked ? new Float32Array(buffer.slice(end + 3 * features)) : null, // not aligned to four bytes
  };
}
