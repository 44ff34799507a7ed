// A text table as lines that can be mended one by one; everything else stays byte for byte.

export const MOST_BYTES = 8_000_000; // larger files are mended where they were made

export async function readText(file) {
  if (file.size > MOST_BYTES) return null;
  const bytes = new Uint8Array(await file.arrayBuffer());
  if (bytes.subarray(0, 4096).some((one) => one === 0)) return null;
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
  } catch {
    return null;
  }
}

export function isLines(text) {
  return text !== null && !/^\s*[[{]/.test(text);
}

// The service counts lines as an editor does, from 1.
export function lineOf(text, number) {
  return text.split(/\r\n|\n|\r/)[number - 1] ?? "";
}

export function withLine(text, number, line) {
  const parts = text.split(/(\r\n|\n|\r)/); // lines at even places, their ends between them
  if (2 * (number - 1) < parts.length) parts[2 * (number - 1)] = line;
  return parts.join("");
}
