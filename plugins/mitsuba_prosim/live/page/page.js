// The page of prosim watch: receives the state as events, fetches the layers that the page shows, and sends requests.

import {follow} from "./events.js";
import {drawColours, drawMap, mapLimit} from "./tone.js";
import {showCarets, showMessages} from "./messages.js";
import {PanZoom} from "./pan_zoom.js";

const find = (id) => document.getElementById(id);
/** Replaces the text of an element only by a different text: a selection stays, a screen reader does not repeat the text. */
const write = (element, text) => { if (element.textContent !== text) element.textContent = text; };
const COMMON_LAYERS = document.querySelectorAll("input[name=layer]").length;
const layers = () => document.querySelectorAll("input[name=layer]");
// `refreshing`: false, "once", or "again" if the state changed while the layers were fetched.
let state = null, shown = null, pointed = null, refreshing = false;

// ---- the shown layers

const layer = () => document.querySelector("input[name=layer]:checked").value;
/** Returns [layer, factors] for each lamp that the user has changed: one factor, or three of red, green and blue. */
const factors = () => [...find("lamps").querySelectorAll("input[type=range]")].flatMap((range) => {
    const colour = document.getElementById(`colour ${range.name}`).value;
    if (Number(range.value) === 1 && colour === "#ffffff") return [];
    const rgb = [1, 3, 5].map((k) => Number((range.value * linear(parseInt(colour.slice(k, k + 2), 16) / 255)).toPrecision(6)));
    return [[range.name, rgb.every((value) => value === rgb[0]) ? [rgb[0]] : rgb]];
});
/** Returns the query of a URL with these factors. */
const mix = () => factors().map(([name, values]) => `mix=${encodeURIComponent(`${name}=${values}`)}`).join("&");
/** Quotes an argument of a command for a shell, if necessary. */
const quoted = (text) => /^[\w.,=-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
/** Returns a file name with the stem of the scene. */
const named = (suffix) => `${(state?.scene ?? "picture").replace(/\.[^.]*$/, "")}.${suffix}`;
/** Converts an sRGB value to a linear value. */
const linear = (c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
const stops = () => Number(find("exposure").value);

/** Draws the shown layer on the canvas. */
function draw() {
    const canvas = find("canvas"), image = shown;
    if (!image) return;
    if (canvas.width !== image.width || canvas.height !== image.height) [canvas.width, canvas.height] = [image.width, image.height];
    const context = canvas.getContext("2d", {willReadFrequently: true}), pixels = context.createImageData(image.width, image.height);
    (image.channels === 3 ? drawColours : drawMap)(image, image.white, stops(), pixels.data);
    context.putImageData(pixels, 0, 0);
    canvas.dataset.number = image.number;
    canvas.dataset.layer = image.layer;
    showScale(image);
}

const MAPS = {error: "Standard error of the luminance", samples: "Samples of a pixel"};

/** Shows the colour scale of a map. */
function showScale(image) {
    const scale = find("scale"), canvas = scale.querySelector("canvas"), marks = scale.querySelectorAll("span");
    scale.hidden = image.channels !== 1;
    if (scale.hidden) return;
    const {width} = canvas, context = canvas.getContext("2d"), pixels = context.createImageData(width, 1);
    drawMap({values: Float32Array.from({length: width}, (_, i) => (i / (width - 1)) ** 2), width, height: 1}, 1, 0, pixels.data);
    context.putImageData(pixels, 0, 0);
    const white = mapLimit(image.white, stops());
    write(scale.querySelector("p"), MAPS[image.layer]);
    write(marks[1], digits(white / 4, 2)); // the colour is a function of the square root of the value
    write(marks[2], `${digits(white, 2)} or more`);
    scale.ariaLabel = `${MAPS[image.layer]}, dark: 0, pale yellow: ${marks[2].textContent}`;
}

/** Fetches the chosen layer if it is not the shown one, and again if it has changed meanwhile. */
async function refresh() {
    if (document.hidden) return;
    if (refreshing) { refreshing = "again"; return; }
    do {
        refreshing = "once";
        await fetchLayer();
    } while (refreshing === "again");
    refreshing = false;
}

async function fetchLayer() {
    const number = state.picture, name = layer(), mixed = mix();
    if (number === null || (shown && shown.number === number && shown.layer === name && shown.mixed === mixed)) return;
    // A coarse picture has no maps; the previous map stays visible until a newer map exists.
    if (!state.layers.includes(name) && name !== "final") return;
    let answer, buffer;
    try {
        answer = await fetch(`layer/${encodeURIComponent(name)}?${mixed}`);
        buffer = await answer.arrayBuffer();
    } catch { return; } // the server has ended
    if (!answer.ok) return;
    const fact = (header) => Number(answer.headers.get(`X-${header}`));
    const [width, height] = [fact("Width"), fact("Height")];
    const values = new Float32Array(buffer), channels = values.length / (width * height);
    shown = {number: fact("Picture"), layer: name, mixed, width, height, channels, values, white: fact("White")};
    if (fact("Picture") < state.picture) refreshing = "again";
    view.resize(...state.size); // only now, because the previous picture may have another size
    draw();
    if (pointed) ask(pointed);
}

// ---- the state

const WORDS = {opening: "opening the scene", rendering: "rendering", done: "done", missing: "the file does not exist; its last picture is shown", failed: "not rendered; waiting for the next save"};

function receive(latest) {
    state = latest;
    const parts = [WORDS[state.status]], percent = `${Math.round(100 * state.progress)} %`;
    write(find("scene"), state.scene);
    document.title = ({rendering: `${percent} `, failed: "error: ", missing: "missing: "}[state.status] ?? "") + state.scene;
    if (state.status === "rendering" && state.progress > 0.01) parts.push(percent);
    if (!["failed", "missing"].includes(state.status)) {
        if (state.samples) parts.push(`${state.samples.toFixed(1)} samples a pixel`);
        if (state.noise !== null) parts.push(`noise ${state.noise.toPrecision(2)}`);
        if (state.seconds) parts.push(duration(state.seconds));
    }
    write(find("state"), parts.join(" · "));
    // A separate text for screen readers, because the state changes ten times a second.
    write(find("announcement"), state.status === "done" ? find("state").textContent : WORDS[state.status]);
    document.body.dataset.status = state.status;
    document.body.dataset.newest = state.picture ?? "";
    find("progress").value = state.progress;
    find("error").hidden = !state.error;
    showMessages(find("error"), state.error ?? "");
    const black = state.error || state.status === "missing" ? "" : state.black ?? "";
    write(find("black"), black);
    find("black").hidden = !black;
    // The exposure that the message names, for an image that is very dark, must be possible.
    find("exposure").max = Math.max(8, stops(), Number(/Exposure (\d+)/.exec(black)?.[1] ?? 0));
    find("warnings").hidden = !state.warnings.length || Boolean(state.error);
    write(find("warnings").querySelector("summary"), state.warnings.length === 1 ? "A warning" : `${state.warnings.length} warnings`);
    showMessages(find("warnings").querySelector("div"), state.warnings.join("\n"));
    showIntegratorLayers(state.layers.filter((name) => name.includes(".")));
    for (const input of layers()) {
        input.disabled = !state.layers.includes(input.value) && input.value !== "final";
        if (["raw", "denoised"].includes(input.value)) input.parentElement.hidden = input.disabled;
    }
    find("camera").disabled = !state.movable;
    find("view").hidden = state.view === null;
    find("home").disabled = false;
    savable(state.picture !== null && ["rendering", "done"].includes(state.status));
    showMix();
    write(find("text"), state.view ?? "");
    refresh();
}

/** Shows the layers of the integrator as choices, and a slider and a colour for each lamp. */
function showIntegratorLayers(names) {
    const box = find("layers"), lamps = find("lamps"), key = JSON.stringify([names, state.names]); // with their lines
    if (box.dataset.key === key) return;
    box.dataset.key = key;
    const chosen = layer(), before = new Map([...lamps.querySelectorAll("input")].map((input) => [input.id, input.value]));
    [...box.children].slice(COMMON_LAYERS).forEach((label) => label.remove());
    lamps.replaceChildren();
    for (const name of names) {
        const label = box.appendChild(document.createElement("label")), input = document.createElement("input");
        const title = name.slice(name.indexOf(".") + 1), text = document.createElement("span");
        Object.assign(input, {type: "radio", name: "layer", value: name, checked: name === chosen});
        text.textContent = title;
        label.append(input, text);
        if (!name.startsWith("lights.")) continue;
        const range = document.createElement("input"), colour = document.createElement("input");
        Object.assign(range, {type: "range", name, id: `factor ${name}`, min: 0, max: 2, step: 0.05});
        Object.assign(colour, {type: "color", id: `colour ${name}`, ariaLabel: `Colour of ${title}`});
        range.value = before.get(range.id) ?? 1;
        colour.value = before.get(colour.id) ?? "#ffffff";
        const named = state.names[title] ?? title, known = named.startsWith(title) ? named : `${title}: ${named}`;
        const lamp = Object.assign(document.createElement("label"), {htmlFor: range.id, textContent: known});
        lamps.append(lamp, range, Object.assign(document.createElement("output"), {value: range.value}), colour);
    }
    lamps.hidden = !lamps.children.length;
    showMix();
    if (!document.querySelector("input[name=layer]:checked")) box.querySelector("input").checked = true;
}

/** Shows the factors of the lamps as numbers and as a command. */
function showMix() {
    const changed = factors();
    for (const output of find("lamps").querySelectorAll("output")) output.value = Number(output.previousElementSibling.value).toFixed(2);
    find("mixed").hidden = !changed.length;
    write(find("command"), ["prosim mix", quoted(named("exr")), ...changed.map(([name, values]) => quoted(`${name.slice(7)}=${values}`))].join(" "));
}

/** Formats a number of seconds. */
function duration(seconds) {
    if (seconds < 100) return `${seconds.toFixed(1)} s`;
    const minutes = Math.floor(seconds / 60);
    return minutes < 100 ? `${minutes} min ${Math.floor(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

function lost(refused) {
    const text = refused
        ? "this prosim watch has ended; open the address that the newer one printed"
        : "prosim watch has ended, or does not respond";
    for (const id of ["state", "announcement"]) write(find(id), text);
    document.body.dataset.status = "lost";
    for (const id of ["camera", "explain", "home"]) find(id).disabled = true;
    for (const input of layers()) input.disabled = !input.checked;
    savable(false);
}

function savable(on) {
    for (const kind of ["exr", "png"]) {
        if (on) find(kind).href = `save/${kind}?exposure=${stops()}&${mix()}`;
        else find(kind).removeAttribute("href");
        find(kind).download = named(kind);
    }
}

// ---- requests

const post = (path) => fetch(path, {method: "POST"}).catch(() => null);

/** Kind of a gesture -> the combined gestures since the last request; the next request waits for the response. */
const gestures = new Map();
let sending = false;

async function gesture(kind, x, y) {
    const [a, b] = gestures.get(kind) ?? (kind === "dolly" ? [1, 0] : [0, 0]);
    gestures.set(kind, kind === "dolly" ? [a * x, 0] : [a + x, b + y]);
    if (sending) return;
    sending = true;
    while (gestures.size) {
        const [[kind, [x, y]]] = gestures;
        gestures.delete(kind);
        await post(`do/${kind}?x=${x}&y=${y}`);
    }
    sending = false;
}

const digits = (v, count = 4) => v === null || v === undefined ? "–" : Number(v.toPrecision(count)).toString();
let details = null, timer = 0;

function showPixel() {
    if (!pointed) return;
    const [x, y] = pointed, image = shown, values = details?.values, lines = [`(${x}, ${y})`];
    if (image?.channels === 3) {
        const [row, column] = [y * image.height / view.height, x * image.width / view.width].map(Math.floor);
        const at = 3 * (row * image.width + column);
        lines.push(`RGB ${[0, 1, 2].map((c) => digits((image.mixed ? null : values?.[image.layer]?.[c]) ?? image.values[at + c])).join(" ")}`);
    } else if (values) lines.push(`RGB ${values.final.map((v) => digits(v)).join(" ")}`);
    if (values?.error !== undefined) lines.push(`error ${digits(values.error)}`, values.samples === 1 ? "1 sample" : `${digits(values.samples)} samples`);
    if (details?.surface) lines.push(details.surface);
    find("pixel").textContent = lines.join(" · ");
}

/** Shows the values of a pixel that the page knows at once, and the values from the server when the pointer rests. */
function point(pixel, announced = false) {
    find("pixel").ariaLive = announced ? "polite" : "off";
    if (!pixel || !state || (pointed && pixel[0] === pointed[0] && pixel[1] === pointed[1])) return;
    pointed = pixel;
    details = null;
    ask(pixel);
}

/** Opens the page that explains a pixel, while Explain is on. */
function explain(pixel) {
    if (pixel && find("explain").checked) window.open(`explain/${pixel[0]}/${pixel[1]}`, "_blank", "noopener");
}

function ask(pixel) {
    showPixel();
    clearTimeout(timer);
    timer = setTimeout(async () => {
        if (pixel[0] >= view.width || pixel[1] >= view.height) return; // a pixel of a larger picture
        const answer = await fetch(`pixel/${pixel[0]}/${pixel[1]}`).catch(() => null);
        if (!answer?.ok || pixel !== pointed) return;
        details = await answer.json();
        showPixel();
    }, 80);
}

new ResizeObserver(() => showCarets(find("notes"))).observe(find("notes")); // also when the user opens the warnings

const view = new PanZoom(find("stage"), find("picture"), {camera: () => find("camera").checked && !find("camera").disabled, gesture, point, explain});

find("layers").addEventListener("change", () => refresh());
function mixed() {
    showMix();
    savable(find("png").hasAttribute("href"));
    refresh();
}
find("lamps").addEventListener("input", mixed);
find("unmix").addEventListener("click", () => {
    for (const input of find("lamps").querySelectorAll("input")) input.value = input.type === "range" ? 1 : "#ffffff";
    find("lamps").querySelector("input").focus(); // the button disappears
    mixed();
});
function exposed() {
    find("stops").textContent = stops() > 0 ? `+${stops()}` : String(stops());
    find("neutral").disabled = stops() === 0;
    draw();
    savable(find("png").hasAttribute("href"));
}
find("exposure").addEventListener("input", exposed);
find("neutral").addEventListener("click", () => {
    find("exposure").value = 0;
    find("exposure").focus();
    exposed();
});
find("camera").addEventListener("change", (e) => find("stage").classList.toggle("camera", e.target.checked));
find("fit").addEventListener("click", () => view.fit());
find("actual").addEventListener("click", () => view.actual());
find("home").addEventListener("click", () => {
    find("stage").focus(); // the button disappears with the view
    post("do/home");
});
/** Lets a button copy the text of an element. */
function copies(button, element) {
    const title = button.textContent;
    button.addEventListener("click", async () => {
        try {
            await navigator.clipboard.writeText(element.textContent);
            button.textContent = "Copied";
        } catch {
            getSelection().selectAllChildren(element);
            button.textContent = navigator.platform.startsWith("Mac") ? "Press ⌘C" : "Press Ctrl-C";
        }
        find("announcement").textContent = button.textContent;
        setTimeout(() => { button.textContent = title; }, 1500);
    });
}
copies(find("copy"), find("text"));
copies(find("copy-command"), find("command"));
follow(receive, lost);
