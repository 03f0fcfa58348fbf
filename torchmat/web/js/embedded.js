// What a page holds: the description of its material as JSON, and all buffers behind each other, packed.

const ID = "torchmat-material";

function bytesOf(base64) {
  const text = atob(base64);
  return Uint8Array.from({ length: text.length }, (_, at) => text.charCodeAt(at));
}

/**
 * @param {Document} document
 * @returns {Promise<{description: object, buffers: Record<string, ArrayBuffer>, extra: object}>}
 */
export async function readEmbedded(document) {
  const { description, extra, parts, data } = JSON.parse(document.getElementById(ID).textContent);
  const packed = new Blob([bytesOf(data)]).stream().pipeThrough(new DecompressionStream("gzip"));
  const whole = await new Response(packed).arrayBuffer();
  const buffers = {};
  let at = 0;
  for (const [name, length] of parts) {
    buffers[name] = whole.slice(at, at + length);
    at += length;
  }
  return { description, buffers, extra };
}
