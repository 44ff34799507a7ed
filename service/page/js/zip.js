// A zip with one file, stored without compression (APPNOTE.TXT 4.3).

const CRC = Uint32Array.from({ length: 256 }, (_, k) => { let value = k; for (let bit = 0; bit < 8; bit += 1) value = value & 1 ? (value >>> 1) ^ 0xedb88320 : value >>> 1; return value >>> 0; });
const MADE = [20, 0, 0, 0, 0x21]; // version 2.0, no flags, stored, midnight, 1980-01-01

export async function zipped(file, name) {
  const content = new Uint8Array(await file.arrayBuffer()), named = new TextEncoder().encode(name);
  const sum = ~content.reduce((crc, byte) => CRC[(crc ^ byte) & 255] ^ (crc >>> 8), -1);
  const about = [...shorts(...MADE), ...words(sum, content.length, content.length), ...shorts(named.length, 0)];
  const head = Uint8Array.from([...words(0x04034b50), ...about, ...named]);
  const entry = Uint8Array.from([...words(0x02014b50), ...shorts(MADE[0]), ...about, ...shorts(0, 0, 0), ...words(0, 0), ...named]);
  const end = Uint8Array.from([...words(0x06054b50), ...shorts(0, 0, 1, 1), ...words(entry.length, head.length + content.length), ...shorts(0)]);
  return new File([head, content, entry, end], "bundle.zip", { type: "application/zip" });
}

const bytes = (size) => (...values) => values.flatMap((value) => Array.from({ length: size }, (_, k) => (value >>> (8 * k)) & 255));
const shorts = bytes(2), words = bytes(4);
