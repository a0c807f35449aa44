// Converts linear values to displayed values, by the same tone curve as for PNG files.

// The sRGB curve as a table. Where the curve is steepest, one step of the table is 1/20 of a step of an 8-bit display.
const STEPS = 65535;
const SRGB = new Uint8ClampedArray(STEPS + 1);
for (let i = 0; i <= STEPS; i++) {
    const c = i / STEPS;
    SRGB[i] = 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
}
const srgb = (v) => SRGB[Math.max(0, Math.min(v, STEPS)) | 0];

/** Writes the pixels of a colour image, with highlights compressed to at most 1 (Reinhard et al. 2002, equation 4).
 * `white`: the 99th percentile of the luminance. */
export function drawColours({values, width, height}, white, stops, pixels) {
    const scale = 2 ** stops, limit = Math.max(1, white * scale) ** 2;
    for (let i = 0, k = 0; k < width * height * 4; i += 3, k += 4) {
        const r = values[i] * scale, g = values[i + 1] * scale, b = values[i + 2] * scale;
        const luminance = Math.max(0.2126 * r + 0.7152 * g + 0.0722 * b, 0);
        const factor = STEPS * (1 + luminance / limit) / (1 + luminance);
        pixels[k] = srgb(r * factor);
        pixels[k + 1] = srgb(g * factor);
        pixels[k + 2] = srgb(b * factor);
        pixels[k + 3] = 255;
    }
}

// The colours of a map: dark blue, violet, red, orange, pale yellow. Lightness grows with the value.
const HUES = [[8, 8, 48], [92, 20, 122], [205, 55, 70], [248, 156, 40], [252, 250, 190]];

/** Returns the smallest value that has the last colour of a map. */
export const mapLimit = (white, stops) => (white || 1) / 2 ** stops;

/** Writes the pixels of a map. The colour is a function of the square root of the value. */
export function drawMap({values, width, height}, white, stops, pixels) {
    const scale = 1 / mapLimit(white, stops);
    for (let i = 0; i < width * height; i++) {
        const position = (HUES.length - 1) * Math.sqrt(Math.min(Math.max(values[i] * scale, 0) || 0, 1));
        const k = Math.min(Math.floor(position), HUES.length - 2), t = position - k;
        for (let c = 0; c < 3; c++) pixels[4 * i + c] = (1 - t) * HUES[k][c] + t * HUES[k + 1][c];
        pixels[4 * i + 3] = 255;
    }
}
