// From linear values to what a screen shows: as the PNGs are made, by the same curve.

/** Numbers of 16 bits as numbers, by their bits. */
export const HALVES = new Float32Array(65536);
for (let bits = 0; bits < 65536; bits++) {
    const exponent = (bits >> 10) & 31, fraction = bits & 1023;
    const size = exponent ? (exponent < 31 ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction ? NaN : Infinity) : fraction * 2 ** -24;
    HALVES[bits] = bits & 32768 ? -size : size;
}

// What a screen shows of 0 to 1, in sRGB: at its steepest, a step of this table is a twentieth of one of the screen's.
const FINE = 65535;
const SHOWN = new Uint8ClampedArray(FINE + 1);
for (let i = 0; i <= FINE; i++) {
    const c = i / FINE;
    SHOWN[i] = 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
}
const shown = (v) => SHOWN[Math.max(0, Math.min(v, FINE)) | 0];

/** Pixels of a colour image, `values` in the bits of halves that count `unit`s, its highlights compressed to at most 1
 * (Reinhard et al. 2002, equation 4). `white`: the luminance that one pixel in a hundred exceeds. */
export function colours({values, width, height, unit}, white, stops, pixels) {
    const scale = unit * 2 ** stops, most = Math.max(1, white * 2 ** stops) ** 2;
    for (let i = 0, k = 0; k < width * height * 4; i += 3, k += 4) {
        const r = HALVES[values[i]] * scale, g = HALVES[values[i + 1]] * scale, b = HALVES[values[i + 2]] * scale;
        const light = Math.max(0.2126 * r + 0.7152 * g + 0.0722 * b, 0);
        const factor = FINE * (1 + light / most) / (1 + light);
        pixels[k] = shown(r * factor);
        pixels[k + 1] = shown(g * factor);
        pixels[k + 2] = shown(b * factor);
        pixels[k + 3] = 255;
    }
}

// Dark blue, violet, red, orange, pale yellow: as light as they are large.
const HUES = [[8, 8, 48], [92, 20, 122], [205, 55, 70], [248, 156, 40], [252, 250, 190]];

/** What the palest colour of a map means, and more. */
export const most = (white, stops) => (white || 1) / 2 ** stops;

/** Pixels of a map: its square root, as far as `white`, in colours. */
export function map({values, width, height}, white, stops, pixels) {
    const scale = 1 / most(white, stops);
    for (let i = 0; i < width * height; i++) {
        const place = (HUES.length - 1) * Math.sqrt(Math.min(Math.max(values[i] * scale, 0) || 0, 1));
        const k = Math.min(Math.floor(place), HUES.length - 2), t = place - k;
        for (let c = 0; c < 3; c++) pixels[4 * i + c] = (1 - t) * HUES[k][c] + t * HUES[k + 1][c];
        pixels[4 * i + 3] = 255;
    }
}
