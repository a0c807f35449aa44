// The page of prosim watch: it is told the state by events, fetches the layers that it shows, and asks for what is wished.

import {colours, fromHalves, map} from "./tone.js";
import {Place} from "./place.js";

const find = (id) => document.getElementById(id);
const TAKES = ["own", "path"];
const shown = {own: null, path: null};
let state = null, pointed = null, wanted = false;

// ---- what is shown

const layer = () => document.querySelector("input[name=layer]:checked").value;
const stops = () => Number(find("exposure").value);

function draw(take) {
    const canvas = find(take), image = shown[take];
    if (!image) return;
    if (canvas.width !== image.width || canvas.height !== image.height) [canvas.width, canvas.height] = [image.width, image.height];
    const context = canvas.getContext("2d", {willReadFrequently: true}), pixels = context.createImageData(image.width, image.height);
    (image.channels === 3 ? colours : map)(image, stops(), pixels.data);
    context.putImageData(pixels, 0, 0);
    canvas.dataset.number = image.number;
    canvas.dataset.layer = image.layer;
}

/** Fetches what is to be shown and is not yet, one after the other; what changes meanwhile, after that. */
async function refresh() {
    if (wanted) { wanted = "again"; return; }
    wanted = "now";
    while (wanted) {
        wanted = "now";
        for (const take of TAKES) await fetchLayer(take);
        wanted = wanted === "again" ? "again" : false;
    }
}

async function fetchLayer(take) {
    const number = state.pictures[take], name = layer(), before = shown[take];
    if (number === undefined || (before && before.number === number && before.layer === name)) return;
    // A coarse picture has no maps: that of before stays until there is another.
    if (!state.layers.includes(name) && name !== "final") return;
    const held = take === "own" || ["final", "error", "samples"].includes(name);
    let answer;
    try { answer = await fetch(`layer/${take}/${held ? name : "final"}`); } catch { return; }
    if (!answer.ok) return;
    const buffer = await answer.arrayBuffer(), fact = (what) => Number(answer.headers.get(`X-${what}`));
    const [width, height] = [fact("Width"), fact("Height")];
    const channels = buffer.byteLength === 6 * width * height ? 3 : 1;
    const values = channels === 3 ? fromHalves(buffer) : new Float32Array(buffer);
    shown[take] = {number: fact("Picture"), layer: name, width, height, channels, values, white: fact("White")};
    if (fact("Picture") !== state.pictures[take]) wanted = "again";
    draw(take);
    if (pointed) ask(pointed);
}

function splitting() {
    const on = state?.compared && shown.path !== null, part = Number(find("split").value);
    find("path").hidden = find("border").hidden = !on;
    find("path").style.clipPath = `inset(0 0 0 ${100 * part}%)`;
    find("border").style.left = `${100 * part}%`;
}

// ---- what is told

const WORDS = {opening: "opening the scene", rendering: "rendering", stopped: "stopped", done: "done", missing: "the file has gone; its last picture is shown until it is there again", failed: "not rendered: the scene is wrong"};

function told(news) {
    state = news;
    find("scene").textContent = document.title = state.scene;
    const parts = [WORDS[state.doing]];
    if (state.doing === "rendering" && state.part > 0.01) parts.push(`${Math.round(100 * state.part)} %`);
    if (!["failed", "missing"].includes(state.doing)) {
        if (state.samples) parts.push(`${state.samples.toFixed(1)} samples a pixel`);
        if (state.noise !== null) parts.push(`noise ${state.noise.toPrecision(2)}`);
        if (state.seconds) parts.push(`${state.seconds.toFixed(1)} s`);
    }
    const text = parts.join(" · ");
    if (find("state").textContent !== text) find("state").textContent = text;
    document.body.dataset.doing = state.doing;
    document.body.dataset.newest = state.pictures.own ?? "";
    find("part").value = state.part;
    find("error").hidden = !state.error;
    tellError(state.error ?? "");
    const black = state.error || state.doing === "missing" ? "" : state.black ?? "";
    if (find("black").textContent !== black) find("black").textContent = black;
    find("black").hidden = !black;
    find("warnings").hidden = !state.warnings.length || Boolean(state.error);
    find("warnings").querySelector("summary").textContent = state.warnings.length === 1 ? "A warning" : `${state.warnings.length} warnings`;
    find("warnings").querySelector("pre").textContent = state.warnings.join("\n\n");
    find("stop").disabled = !["rendering", "stopped"].includes(state.doing);
    find("stop").textContent = state.doing === "stopped" ? "Go on" : "Stop";
    for (const input of document.querySelectorAll("input[name=layer]")) {
        input.disabled = !state.layers.includes(input.value) && input.value !== "final";
        if (["raw", "denoised"].includes(input.value)) input.parentElement.hidden = input.disabled;
    }
    find("camera").disabled = !state.movable;
    find("compare").disabled = state.alone !== null || !state.integrator;
    find("compare").parentElement.title = state.alone ?? "";
    find("compare").checked = state.compared;
    find("splitting").hidden = !state.compared;
    find("rivals").textContent = `${state.integrator} | path`;
    find("view").hidden = state.view === null;
    find("home").disabled = false;
    savable(state.pictures.own !== undefined);
    find("text").textContent = state.view ?? "";
    if (state.pictures.path === undefined) shown.path = null;
    if (state.size[0]) place.size(...state.size);
    splitting();
    refresh().then(splitting);
}

function tellError(error) {
    const box = find("error"), [reason, ...place] = error.split("\n");
    if (box.dataset.told === error) return;
    box.dataset.told = error;
    box.querySelector("p").textContent = reason;
    box.querySelector("pre").textContent = place.join("\n");
}

function listen() {
    const events = new EventSource("events");
    events.onmessage = (e) => told(JSON.parse(e.data));
    events.onerror = () => {
        find("state").textContent = "prosim watch has ended, or can't be reached";
        document.body.dataset.doing = "gone";
        for (const id of ["stop", "camera", "compare", "home"]) find(id).disabled = true;
        savable(false);
    };
}

function savable(on) {
    for (const kind of ["exr", "png"]) {
        if (on) find(kind).href = `save/${kind}?exposure=${stops()}`;
        else find(kind).removeAttribute("href");
    }
}

// ---- what is wished

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

const digits = (v) => v === null || v === undefined ? "–" : Number(v.toPrecision(4)).toString();
let details = null, asking = 0;

function tellPixel() {
    if (!pointed) return;
    const [x, y] = pointed, image = shown.own, lines = [`(${x}, ${y})`];
    if (image?.channels === 3) {
        const [row, column] = [y * image.height / place.height, x * image.width / place.width].map(Math.floor);
        const at = 3 * (row * image.width + column);
        lines.push(`RGB ${[0, 1, 2].map((c) => digits(details?.own?.final[c] ?? image.values[at + c])).join(" ")}`);
    } else if (details?.own) lines.push(`RGB ${details.own.final.map(digits).join(" ")}`);
    if (details?.path) lines.push(`path ${details.path.final.map(digits).join(" ")}`);
    if (details?.own?.error !== undefined) lines.push(`error ${digits(details.own.error)}`, `${digits(details.own.samples)} samples`);
    if (details?.seen) lines.push(details.seen);
    find("pixel").textContent = lines.join(" · ");
}

/** Tells the pixel at once as far as it is known here, and the rest when the pointer rests. */
function point(pixel) {
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

const place = new Place(find("stage"), find("picture"), {camera: () => find("camera").checked, gesture, moved: splitting, point});

find("layers").addEventListener("change", () => refresh());
find("exposure").addEventListener("input", () => {
    find("stops").textContent = stops() > 0 ? `+${stops()}` : String(stops());
    TAKES.forEach(draw);
    savable(find("png").hasAttribute("href"));
});
find("split").addEventListener("input", splitting);
find("stop").addEventListener("click", () => post(state.doing === "stopped" ? "do/go" : "do/stop"));
find("compare").addEventListener("change", (e) => post(e.target.checked ? "do/compare" : "do/alone"));
find("camera").addEventListener("change", (e) => find("stage").classList.toggle("camera", e.target.checked));
find("fit").addEventListener("click", () => place.fit());
find("actual").addEventListener("click", () => place.actual());
find("home").addEventListener("click", () => post("do/home"));
find("copy").addEventListener("click", async () => {
    try {
        await navigator.clipboard.writeText(state.view);
        find("copy").textContent = "Copied";
    } catch {
        getSelection().selectAllChildren(find("text"));
        find("copy").textContent = "Press Ctrl-C";
    }
    setTimeout(() => { find("copy").textContent = "Copy the view"; }, 1500);
});
listen();
