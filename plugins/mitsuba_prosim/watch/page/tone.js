// From linear values to what a screen shows: as the PNGs are made, by the same curve.

const HALVES = new Float32Array(65536);
for (let bits = 0; bits < 65536; bits++) {
    const exponent = (bits >> 10) & 31, fraction = bits & 1023;
    const size = exponent ? (exponent < 31 ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction ? NaN : Infinity) : fraction * 2 ** -24;
    HALVES[bits] = bits & 32768 ? -size : size;
}

/** Numbers of 16 bits as numbers of 32. */
export function fromHalves(buffer) {
    return new Float32Array(new Uint16Array(buffer)).map((bits) => HALVES[bits]);
}

function srgb(c) {
    return 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
}

/** Pixels of a colour image, its highlights compressed to at most 1 (Reinhard et al. 2002, equation 4). `white`: the
 * luminance that one pixel in a hundred exceeds. */
export function colours({values, width, height, white}, stops, pixels) {
    const scale = 2 ** stops, most = Math.max(1, white * scale) ** 2;
    for (let i = 0, k = 0; k < width * height * 4; i += 3, k += 4) {
        const r = values[i] * scale, g = values[i + 1] * scale, b = values[i + 2] * scale;
        const light = Math.max(0.2126 * r + 0.7152 * g + 0.0722 * b, 0);
        const factor = (1 + light / most) / (1 + light);
        pixels[k] = srgb(r * factor);
        pixels[k + 1] = srgb(g * factor);
        pixels[k + 2] = srgb(b * factor);
        pixels[k + 3] = 255;
    }
}

// Dark blue, violet, red, orange, pale yellow: as light as they are large.
const STOPS = [[8, 8, 48], [92, 20, 122], [205, 55, 70], [248, 156, 40], [252, 250, 190]];

/** Pixels of a map: its square root, as far as `white`, in colours. */
export function map({values, width, height, white}, stops, pixels) {
    const scale = 2 ** stops / (white || 1);
    for (let i = 0; i < width * height; i++) {
        const place = (STOPS.length - 1) * Math.sqrt(Math.min(Math.max(values[i] * scale, 0) || 0, 1));
        const k = Math.min(Math.floor(place), STOPS.length - 2), t = place - k;
        for (let c = 0; c < 3; c++) pixels[4 * i + c] = (1 - t) * STOPS[k][c] + t * STOPS[k + 1][c];
        pixels[4 * i + 3] = 255;
    }
}
