// The page of prosim watch: it receives the state as events, fetches the layers that it shows, and sends requests.

import {follow} from "./events.js";
import {colours, HALVES, map, most} from "./tone.js";
import {showCarets, tell} from "./messages.js";
import {Place} from "./place.js";

const find = (id) => document.getElementById(id);
/** Writes text if it differs: a selection stays, and a screen reader reads nothing twice. */
const write = (element, text) => { if (element.textContent !== text) element.textContent = text; };
const TAKES = ["own", "path"], FIXED = document.querySelectorAll("input[name=layer]").length;
const layers = () => document.querySelectorAll("input[name=layer]");
const shown = {own: null, path: null};
let state = null, pointed = null, wanted = false, comparing = null;

// ---- the shown layers

const layer = () => document.querySelector("input[name=layer]:checked").value;
/** The factors of the lamps that are not as the scene has them, for the server. */
const mix = () => [...find("lamps").querySelectorAll("input[type=range]")].flatMap((range) => {
    const colour = range.nextElementSibling.value;
    if (Number(range.value) === 1 && colour === "#ffffff") return [];
    const factors = [1, 3, 5].map((k) => range.value * linear(parseInt(colour.slice(k, k + 2), 16) / 255));
    return [`mix=${encodeURIComponent(`${range.name}=${factors}`)}`];
}).join("&");
/** A value of the screen, which is in sRGB, as a factor. */
const linear = (c) => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
const stops = () => Number(find("exposure").value);

/** Both takes as bright as each other: a value has one colour. */
function draw(take) {
    const canvas = find(take), image = shown[take], white = (shown.own ?? image)?.white;
    if (!image) return;
    if (canvas.width !== image.width || canvas.height !== image.height) [canvas.width, canvas.height] = [image.width, image.height];
    const context = canvas.getContext("2d", {willReadFrequently: true}), pixels = context.createImageData(image.width, image.height);
    (image.channels === 3 ? colours : map)(image, white, stops(), pixels.data);
    context.putImageData(pixels, 0, 0);
    canvas.dataset.number = image.number;
    canvas.dataset.layer = image.layer;
    if (take === "own") tellScale(image);
}

const MAPS = {error: "Standard error of the luminance", samples: "Samples of a pixel"};

/** What the colours of a map mean. */
function tellScale(image) {
    const scale = find("scale"), canvas = scale.querySelector("canvas"), marks = scale.querySelectorAll("span");
    scale.hidden = image.channels !== 1;
    if (scale.hidden) return;
    const {width} = canvas, context = canvas.getContext("2d"), pixels = context.createImageData(width, 1);
    map({values: Float32Array.from({length: width}, (_, i) => (i / (width - 1)) ** 2), width, height: 1}, 1, 0, pixels.data);
    context.putImageData(pixels, 0, 0);
    const white = most(image.white, stops());
    write(scale.querySelector("p"), MAPS[image.layer]);
    write(marks[1], digits(white / 4, 2)); // by the square root
    write(marks[2], `${digits(white, 2)} or more`);
    scale.ariaLabel = `${MAPS[image.layer]}, dark: 0, pale yellow: ${marks[2].textContent}`;
}

/** Fetches the missing layers one after the other; then those that have changed meanwhile. */
async function refresh() {
    if (document.hidden) return; // nobody sees it
    if (wanted) { wanted = "again"; return; }
    wanted = "now";
    while (wanted) {
        wanted = "now";
        for (const take of TAKES) await fetchLayer(take);
        wanted = wanted === "again" ? "again" : false;
    }
}

async function fetchLayer(take) {
    const number = state.pictures[take], name = layer(), before = shown[take], mixed = take === "own" ? mix() : "";
    if (number === undefined || (before && before.number === number && before.layer === name && before.mixed === mixed)) return;
    // A coarse picture has no maps: that of before stays until there is another.
    if (!state.layers.includes(name) && name !== "final") return;
    const held = take === "own" || ["final", "error", "samples"].includes(name);
    let answer, buffer;
    try {
        answer = await fetch(`layer/${take}/${held ? encodeURIComponent(name) : "final"}?${mixed}`);
        buffer = await answer.arrayBuffer();
    } catch { return; } // the server has gone, in the midst of it perhaps
    if (!answer.ok) return;
    const fact = (what) => Number(answer.headers.get(`X-${what}`));
    const [width, height] = [fact("Width"), fact("Height")];
    const channels = buffer.byteLength === 6 * width * height ? 3 : 1;
    const values = channels === 3 ? new Uint16Array(buffer) : new Float32Array(buffer);
    shown[take] = {number: fact("Picture"), layer: name, mixed, width, height, channels, values, white: fact("White"), unit: fact("Unit")};
    if (fact("Picture") < state.pictures[take]) wanted = "again";
    if (take === "own") place.size(...state.size); // not before: the picture of before has its own
    TAKES.slice(TAKES.indexOf(take)).forEach(draw); // the other's white is that of the scene's own
    if (pointed) ask(pointed);
}

function splitting() {
    const on = state?.compared && shown.path !== null, part = find("split").value;
    find("path").hidden = find("border").hidden = !on;
    find("path").style.clipPath = `inset(0 0 0 ${part}%)`;
    find("border").style.left = find("split").ariaValueText = `${part}%`;
}

// ---- the state

const WORDS = {opening: "opening the scene", rendering: "rendering", stopped: "stopped", done: "done", missing: "the file has gone; its last picture is shown until it is there again", failed: "not rendered; the next save is awaited"};

function receive(news) {
    state = news;
    const parts = [WORDS[state.doing]], whose = state.compared ? `${state.integrator}: ` : "", percent = `${Math.round(100 * state.part)} %`;
    write(find("scene"), state.scene);
    document.title = ({rendering: `${percent} `, failed: "wrong: ", missing: "gone: "}[state.doing] ?? "") + state.scene;
    if (state.doing === "rendering" && state.part > 0.01) parts.push(state.compared ? `${percent} of both` : percent);
    if (!["failed", "missing"].includes(state.doing)) {
        if (state.samples) parts.push(`${whose}${state.samples.toFixed(1)} samples a pixel`);
        if (state.noise !== null) parts.push(`noise ${state.noise.toPrecision(2)}`);
        if (state.seconds) parts.push(duration(state.seconds));
    }
    write(find("state"), parts.join(" · "));
    // What changes ten times a second is not read out.
    write(find("announcement"), state.doing === "done" ? find("state").textContent : WORDS[state.doing]);
    document.body.dataset.doing = state.doing;
    document.body.dataset.newest = state.pictures.own ?? "";
    find("part").value = state.part;
    find("error").hidden = !state.error;
    tell(find("error"), state.error ?? "");
    const black = state.error || state.doing === "missing" ? "" : state.black ?? "";
    write(find("black"), black);
    find("black").hidden = !black;
    find("warnings").hidden = !state.warnings.length || Boolean(state.error);
    write(find("warnings").querySelector("summary"), state.warnings.length === 1 ? "A warning" : `${state.warnings.length} warnings`);
    tell(find("warnings").querySelector("div"), state.warnings.join("\n"));
    find("stop").disabled = !["rendering", "stopped"].includes(state.doing);
    write(find("stop"), state.doing === "stopped" ? "Go on" : "Stop");
    partsOf(state.layers.filter((name) => name.includes(".")));
    for (const input of layers()) {
        input.disabled = !state.layers.includes(input.value) && input.value !== "final";
        if (["raw", "denoised"].includes(input.value)) input.parentElement.hidden = input.disabled;
    }
    find("camera").disabled = !state.movable;
    find("compare").disabled = state.alone !== null || !state.integrator;
    find("compare").parentElement.title = state.alone ?? "";
    // It is heard between two portions, with a crop window after the wave.
    if (comparing === state.compared || !["rendering", "stopped"].includes(state.doing)) comparing = null;
    find("compare").checked = comparing ?? state.compared;
    find("splitting").hidden = !state.compared;
    write(find("rivals"), `${state.integrator} | path`);
    find("view").hidden = state.view === null;
    find("home").disabled = false;
    savable(state.pictures.own !== undefined);
    write(find("text"), state.view ?? "");
    if (state.pictures.path === undefined) shown.path = null;
    splitting();
    refresh().then(splitting);
}

/** The layers of the integrator as choices; and its lamps, with the factors that they have here. */
function partsOf(names) {
    const box = find("layers"), lamps = find("lamps"), told = names.join();
    if (box.dataset.told === told) return;
    box.dataset.told = told;
    const chosen = layer(), before = new Map([...lamps.querySelectorAll("input")].map((input) => [input.id, input.value]));
    [...box.children].slice(FIXED).forEach((label) => label.remove());
    lamps.replaceChildren();
    for (const name of names) {
        const label = box.appendChild(document.createElement("label")), input = document.createElement("input");
        const word = name.slice(name.indexOf(".") + 1), text = document.createElement("span");
        Object.assign(input, {type: "radio", name: "layer", value: name, checked: name === chosen});
        text.textContent = word;
        label.append(input, text);
        if (!name.startsWith("lights.")) continue;
        const range = document.createElement("input"), colour = document.createElement("input");
        Object.assign(range, {type: "range", name, id: `factor ${name}`, min: 0, max: 2, step: 0.05, ariaLabel: `Factor of ${word}`});
        Object.assign(colour, {type: "color", id: `colour ${name}`, ariaLabel: `Colour of ${word}`});
        range.value = before.get(range.id) ?? 1;
        colour.value = before.get(colour.id) ?? "#ffffff";
        lamps.append(text.cloneNode(true), range, colour);
    }
    lamps.hidden = !lamps.children.length;
    if (!document.querySelector("input[name=layer]:checked")) box.querySelector("input").checked = true;
}

/** Seconds, as one says them. */
function duration(seconds) {
    if (seconds < 100) return `${seconds.toFixed(1)} s`;
    const minutes = Math.floor(seconds / 60);
    return minutes < 100 ? `${minutes} min ${Math.floor(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

function lost(refused) {
    const text = refused
        ? "this prosim watch has ended; one that was started since has printed another address"
        : "prosim watch has ended, or does not answer";
    for (const id of ["state", "announcement"]) write(find(id), text);
    document.body.dataset.doing = "gone";
    for (const id of ["stop", "camera", "compare", "home"]) find(id).disabled = true;
    for (const input of layers()) input.disabled = !input.checked;
    savable(false);
}

function savable(on) {
    for (const kind of ["exr", "png"]) {
        if (on) find(kind).href = `save/${kind}?exposure=${stops()}&${mix()}`;
        else find(kind).removeAttribute("href");
    }
}

// ---- requests

const post = (path) => fetch(path, {method: "POST"}).catch(() => null);

/** Gestures since the last request, as one: none is sent before the last is answered. */
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
        await post(`move/${kind}?x=${x}&y=${y}`);
    }
    sending = false;
}

const digits = (v, many = 4) => v === null || v === undefined ? "–" : Number(v.toPrecision(many)).toString();
let details = null, asking = 0;

function tellPixel() {
    if (!pointed) return;
    const [x, y] = pointed, image = shown.own, lines = [`(${x}, ${y})`];
    if (image?.channels === 3) {
        const [row, column] = [y * image.height / place.height, x * image.width / place.width].map(Math.floor);
        const at = 3 * (row * image.width + column);
        lines.push(`RGB ${[0, 1, 2].map((c) => digits((image.mixed ? null : details?.own?.[image.layer]?.[c]) ?? HALVES[image.values[at + c]] * image.unit)).join(" ")}`);
    } else if (details?.own) lines.push(`RGB ${details.own.final.map((v) => digits(v)).join(" ")}`);
    if (details?.path) lines.push(`path ${details.path.final.map((v) => digits(v)).join(" ")}`);
    if (details?.own?.error !== undefined) lines.push(`error ${digits(details.own.error)}`, details.own.samples === 1 ? "1 sample" : `${digits(details.own.samples)} samples`);
    if (details?.surface) lines.push(details.surface);
    find("pixel").textContent = lines.join(" · ");
}

/** Shows the known values of a pixel at once, and the others when the pointer rests; announces them for keys. */
function point(pixel, aloud = false) {
    find("pixel").ariaLive = aloud ? "polite" : "off";
    if (!pixel || !state || (pointed && pixel[0] === pointed[0] && pixel[1] === pointed[1])) return;
    pointed = pixel;
    details = null;
    ask(pixel);
}

function ask(pixel) {
    tellPixel();
    clearTimeout(asking);
    asking = setTimeout(async () => {
        if (pixel[0] >= place.width || pixel[1] >= place.height) return; // of a larger picture
        const answer = await fetch(`pixel/${pixel[0]}/${pixel[1]}`).catch(() => null);
        if (!answer?.ok || pixel !== pointed) return;
        details = await answer.json();
        tellPixel();
    }, 80);
}

new ResizeObserver(() => showCarets(find("notes"))).observe(find("notes")); // also when the warnings are opened

const place = new Place(find("stage"), find("picture"), {camera: () => find("camera").checked && !find("camera").disabled, gesture, moved: splitting, point});

find("layers").addEventListener("change", () => refresh());
find("lamps").addEventListener("input", () => {
    savable(find("png").hasAttribute("href"));
    refresh();
});
function exposed() {
    find("stops").textContent = stops() > 0 ? `+${stops()}` : String(stops());
    find("neutral").disabled = stops() === 0;
    TAKES.forEach(draw);
    savable(find("png").hasAttribute("href"));
}
find("exposure").addEventListener("input", exposed);
find("neutral").addEventListener("click", () => {
    find("exposure").value = 0;
    find("exposure").focus();
    exposed();
});
find("split").addEventListener("input", splitting);
find("border").addEventListener("pointerdown", (e) => {
    e.stopPropagation(); // it is no picture that is moved
    e.target.setPointerCapture(e.pointerId);
});
find("border").addEventListener("pointermove", (e) => {
    if (!e.target.hasPointerCapture(e.pointerId)) return;
    const box = find("picture").getBoundingClientRect();
    find("split").value = 100 * (e.clientX - box.left) / box.width;
    splitting();
});
find("stop").addEventListener("click", () => post(state.doing === "stopped" ? "do/go" : "do/stop"));
find("compare").addEventListener("change", (e) => {
    comparing = e.target.checked;
    post(comparing ? "do/compare" : "do/alone");
});
find("camera").addEventListener("change", (e) => find("stage").classList.toggle("camera", e.target.checked));
find("fit").addEventListener("click", () => place.fit());
find("actual").addEventListener("click", () => place.actual());
find("home").addEventListener("click", () => {
    find("stage").focus(); // the button goes with the view
    post("do/home");
});
find("copy").addEventListener("click", async () => {
    try {
        await navigator.clipboard.writeText(state.view);
        find("copy").textContent = "Copied";
    } catch {
        getSelection().selectAllChildren(find("text"));
        find("copy").textContent = navigator.platform.startsWith("Mac") ? "Press ⌘C" : "Press Ctrl-C";
    }
    find("announcement").textContent = find("copy").textContent;
    setTimeout(() => { find("copy").textContent = "Copy the view"; }, 1500);
});
follow(receive, lost);
