"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const find = id => document.getElementById(id);
const sum = values => values.reduce((a, b) => a + b, 0);
const number = x => String(Number(x.toPrecision(Math.abs(x) < 1e-3 ? 2 : 4)));
/** The numbers as text; those that only rounding makes different from 0 beside the greatest are 0. */
const list = values => values.map(x => number(Math.abs(x) < 1e-5 * Math.max(...values.map(Math.abs)) ? 0 : x)).join("  ");
/** A colour of the page for SVG, which follows the colour scheme; and its present value for a canvas. */
const css = name => `var(${name})`;
const present = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Makes an SVG element with attributes and children. */
function svg(name, attributes = {}, ...children) {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.append(...children);
    return element;
}

/** Makes an element do `action` at a click and at Enter; `label` is its name for screen readers and its tooltip. */
function choosable(element, label, action) {
    element.setAttribute("tabindex", "0");
    element.setAttribute("role", "button");
    element.setAttribute("aria-label", label);
    element.prepend(svg("title", {}, label));
    element.addEventListener("click", action);
    element.addEventListener("keydown", event => {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); action(); }
    });
    return element;
}

/** Makes an HTML element with a text. */
function html(name, text) {
    const element = document.createElement(name);
    element.textContent = text;
    return element;
}

/** The shown tree. */
let tree = data.trees[0];
const parentOf = node => tree.nodes.find(one => one.number === node.parent);
/** Whether the light of a lamp's point would be scattered if nothing were in the way. */
const counts = lamp => lamp.state === "visible" || lamp.state === "hidden";
const total = nodes => nodes.map(one => one.contribution).reduce((a, b) => a.map((x, k) => x + b[k]));
/** The squared error of each sample. */
const light = data.values.map(sum), mean = sum(light) / light.length, errors = light.map(x => (x - mean) ** 2);

// ---------------------------------------------------------------- the image

/** The place of a point of the world in the image, in pixels; null behind the camera. */
function project(p) {
    const d = p.map((x, k) => x - data.camera.origin[k]);
    const [s, u, v] = data.camera.matrix.map(row => sum(row.map((m, k) => m * d[k])));
    return s > 0 ? [u / s * data.camera.size[0] - data.camera.offset[0], v / s * data.camera.size[1] - data.camera.offset[1]] : null;
}

function showImage() {
    const frame = find("frame"), [w, h] = data.size, line = w / 300;
    if (!data.image) { frame.parentElement.hidden = true; return; }
    const image = new Image();
    image.src = data.image;
    image.onload = () => { image.style.imageRendering = image.naturalWidth < w ? "auto" : "pixelated"; }; // smooth if coarse
    image.alt = `The rendered image; the pixel is ${data.pixel}`;
    const drawing = svg("svg", { viewBox: `0 0 ${w} ${h}`, "aria-hidden": "true" });
    for (const node of data.camera ? tree.nodes : []) {
        const to = node.position && project(node.position);
        const from = node.parent ? project(node.origin) : null;
        if (to && from) drawing.append(svg("line", { x1: from[0], y1: from[1], x2: to[0], y2: to[1], stroke: "#4cf", "stroke-width": 1.5 * line }));
        for (const lamp of to ? node.lamps : []) {
            const end = project(lamp.point);
            if (!end || !counts(lamp)) continue;
            const dashes = lamp.state === "hidden" ? { "stroke-dasharray": `${3 * line} ${3 * line}` } : {};
            drawing.append(svg("line", { x1: to[0], y1: to[1], x2: end[0], y2: end[1], stroke: "#fb4", "stroke-width": line, ...dashes }));
        }
    }
    const r = 4 * line, [x, y] = data.pixel;
    for (const [colour, width] of [["#000", 3 * line], ["#fff", 1.5 * line]])
        drawing.append(svg("rect", { x: x + 0.5 - r, y: y + 0.5 - r, width: 2 * r, height: 2 * r, fill: "none", stroke: colour, "stroke-width": width }));
    frame.replaceChildren(image, drawing);
}

// ---------------------------------------------------------------- the tree

/** Width of a line for an amount of light, relative to the greatest amount. */
const thickness = (light, most) => 1 + 6 * Math.sqrt(Math.max(light, 0) / (most || 1));

function showTree() {
    const nodes = tree.nodes, places = new Map(), below = new Map();
    const children = node => nodes.filter(other => other.parent === node.number);
    const lamps = node => node.lamps.filter(counts).slice(0, 6);
    let column = 0, deepest = 0;
    const arrange = (node, depth) => {
        deepest = Math.max(deepest, depth);
        const inner = children(node).map(child => arrange(child, depth + 1));
        const own = lamps(node).map(() => column++);
        const columns = [...inner, ...own];
        const x = columns.length ? sum(columns) / columns.length : column++;
        places.set(node.number, { x, depth, own });
        below.set(node.number, sum(node.contribution) + sum(children(node).map(child => below.get(child.number))));
        return x;
    };
    arrange(nodes[0], 0);
    const dx = 40, dy = 70, width = Math.max(column * dx + 40, 200), X = x => 30 + x * dx, Y = depth => 24 + depth * dy;
    const drawing = svg("svg", { width, height: Y(deepest) + 44, role: "group", "aria-label": "Tree of the rays" });
    const most = Math.max(...below.values());
    for (const node of nodes) {
        const { x, depth, own } = places.get(node.number), parent = places.get(node.parent);
        if (parent) drawing.append(svg("line", { x1: X(parent.x), y1: Y(parent.depth), x2: X(x), y2: Y(depth), stroke: css("--accent"), "stroke-width": thickness(below.get(node.number), most) }));
        lamps(node).forEach((lamp, k) => {
            const hidden = lamp.state === "hidden" ? { "stroke-dasharray": "3 3" } : {};
            drawing.append(svg("line", { x1: X(x), y1: Y(depth), x2: X(own[k]), y2: Y(depth) + 38, stroke: css("--lamp"), "stroke-width": thickness(sum(lamp.contribution), most), ...hidden }));
            drawing.append(svg("circle", { cx: X(own[k]), cy: Y(depth) + 38, r: 4, fill: lamp.state === "hidden" ? "none" : css("--lamp"), stroke: css("--lamp") }, svg("title", {}, `${lamp.lamp}, ${lamp.state}`)));
        });
    }
    for (const node of nodes) {
        const { x, depth } = places.get(node.number);
        const circle = svg("circle", { cx: X(x), cy: Y(depth), r: 16, fill: css(node.emission ? "--lamp" : "--raised"), stroke: css("--ink") });
        circle.dataset.number = node.number;
        const label = `Node ${node.number}: ${node.lobe}, ${node.shape || "nothing met"}, adds ${number(sum(node.contribution))}`;
        drawing.append(choosable(circle, label, () => showNode(node)));
        const long = node.number > 9999 ? { textLength: 28, lengthAdjust: "spacingAndGlyphs" } : {};
        drawing.append(svg("text", { x: X(x), y: Y(depth) + 4, "text-anchor": "middle", ...long }, String(node.number)));
    }
    find("tree").replaceChildren(drawing);
    const share = !sum(errors) ? "" : `, ${number(100 * errors[tree.sample] / sum(errors))} % of the squared error`;
    find("sample").textContent = `sample ${tree.sample}: ${list(data.values[tree.sample])}${share}`;
}

/** Whether a node is `top` or in one of its branches. */
const isWithin = (node, top) => node && (node === top || isWithin(parentOf(node), top));

/** Shows the numbers of a node as a table, and marks it in the tree. */
function showNode(node) {
    for (const circle of find("tree").querySelectorAll("[data-number]")) {
        const own = Number(circle.dataset.number) === node.number;
        circle.setAttribute("stroke-width", own ? 4 : 1.5);
        circle.setAttribute("aria-pressed", own);
    }
    const rows = [
        ["node", `${node.number}, from ${node.parent ? "node " + node.parent : "the camera"}, level ${node.level}`],
        ["meets", node.shape ? node.shape + (node.line ? " – " + node.line : "") : "nothing"],
        ["lobe", node.lobe + (node.density === null ? "" : `, density ${number(node.density)} / sr`) + (node.probability === null ? "" : `, probability ${number(node.probability)}`)],
        ["survives with", `probability ${number(node.survival)}`], ["throughput", list(node.throughput)],
        ["position", node.position ? list(node.position) : "–"], ["normal", node.normal ? list(node.normal) : "–"],
    ];
    for (const lamp of node.lamps) {
        const state = lamp.occluder && lamp.state !== "hidden" ? `${lamp.state}, and ` : lamp.state === "hidden" ? "" : lamp.state;
        rows.push([`lamp ${lamp.lamp}`, `${state}${lamp.occluder ? `hidden by ${lamp.occluder}` : ""}; adds ${list(lamp.contribution)}; density ${number(lamp.density)} / sr`]);
        for (const lobe of lamp.lobes) if (lobe.bsdf.some(Boolean)) rows.push(["", `${lobe.name}: BSDF × cosine ${list(lobe.bsdf)}${lobe.density ? `, density ${number(lobe.density)} / sr` : ""}, MIS weight ${number(lobe.weight)}`]);
    }
    if (node.left) rows.push([`${node.left} other lamps`, `add ${list(node.others)}`]);
    if (node.emission) rows.push([`meets lamp ${node.emission.lamp}`, `adds ${list(node.emission.contribution)}; lamp's density ${number(node.emission.density)} / sr, MIS weight ${number(node.emission.weight)}`]);
    for (const name of ["ambient", "background", "photons"]) if (node[name].some(Boolean)) rows.push([name, `adds ${list(node[name])}`]);
    rows.push(["adds in all", list(node.contribution)], ["with its branches", list(total(tree.nodes.filter(other => isWithin(other, node))))]);
    const table = document.createElement("table");
    for (const [name, text] of rows) {
        const row = table.insertRow();
        row.append(html("th", name), html("td", text));
    }
    find("node").replaceChildren(table);
    showPatterns(node);
}

/** Shows the random numbers of a node, one square for each pair of numbers; a dot is a sample of the pixel. */
function showPatterns(node) {
    const squares = data.patterns.filter(([number]) => number === node.number).map(([, name, points]) => {
        const pass = i => data.n && Math.floor(i / data.n) === Math.floor(tree.sample / data.n);
        const drawing = svg("svg", { viewBox: "-2 -2 104 104", width: 130, role: "img", "aria-label": `Random numbers: ${name}` });
        const line = (a, b) => drawing.append(svg("path", { d: `M${a}L${b}`, stroke: css("--line"), "stroke-width": 0.4 }));
        for (let k = 0, n = data.n || 1; k <= n; k++) {
            line([100 * k / n, 0], [100 * k / n, 100]);
            line([0, 100 * k / n], [100, 100 * k / n]);
        }
        for (let i = 0; 2 * i < points.length; i++) {
            const place = { cx: points[2 * i] / 10, cy: points[2 * i + 1] / 10 }, own = i === tree.sample;
            if (own) drawing.append(svg("circle", { ...place, r: 6, fill: "none", stroke: css("--lamp"), "stroke-width": 2 }));
            const colour = own ? "--lamp" : pass(i) ? "--accent" : "--line";
            drawing.append(svg("circle", { ...place, r: own || pass(i) ? 2.6 : 1.6, fill: css(colour) }, svg("title", {}, `Sample ${i}`)));
        }
        const figure = document.createElement("figure");
        figure.append(drawing, html("figcaption", name));
        return figure;
    });
    find("patterns").replaceChildren(...squares);
    find("numbers").hidden = !squares.length;
}

// ---------------------------------------------------------------- the view from outside

const view = { yaw: 0.6, pitch: 0.4, zoom: 1 };

function showOutside() {
    const canvas = find("outside"), g = canvas.getContext("2d"), scale = devicePixelRatio || 1;
    const w = canvas.clientWidth, h = canvas.clientHeight;
    [canvas.width, canvas.height] = [w * scale, h * scale];
    g.scale(scale, scale);
    const points = tree.nodes.flatMap(node => node.position ? [node.position, node.origin] : [node.origin]);
    const low = [0, 1, 2].map(k => Math.min(...points.map(p => p[k]))), high = [0, 1, 2].map(k => Math.max(...points.map(p => p[k])));
    const middle = low.map((a, k) => (a + high[k]) / 2), size = Math.hypot(...low.map((a, k) => high[k] - a)) || 1;
    const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
    const k = 0.8 * Math.min(w, h) / size * view.zoom;
    const at = p => {
        const [x, y, z] = p.map((v, i) => v - middle[i]), depth = sy * x + cy * z;
        return [w / 2 + k * (cy * x - sy * z), h / 2 - k * (cp * y - sp * depth)];
    };
    const line = (a, b, colour, width = 1, dashes = []) => {
        g.strokeStyle = colour; g.lineWidth = width; g.setLineDash(dashes);
        g.beginPath(); g.moveTo(...at(a)); g.lineTo(...at(b)); g.stroke();
    };
    for (const [a, b] of data.boxes)
        for (let i = 0; i < 8; i++)
            for (const bit of [1, 2, 4])
                if (!(i & bit)) line([0, 1, 2].map(j => i >> j & 1 ? b[j] : a[j]), [0, 1, 2].map(j => (i | bit) >> j & 1 ? b[j] : a[j]), present("--line"), 0.5);
    for (const node of tree.nodes) {
        const end = node.position || node.origin.map((o, i) => o + node.direction[i] * size / 4);
        for (const lamp of node.position ? node.lamps : [])
            if (counts(lamp)) line(end, lamp.point, present("--lamp"), 1, lamp.state === "hidden" ? [4, 4] : []);
        line(node.origin, end, present("--accent"), 2);
        if (node.normal) line(end, end.map((p, i) => p + node.normal[i] * size / 12), present("--ink"));
    }
    g.fillStyle = present("--ink");
    const inside = ([x, y]) => x > 4 && x < w - 60 && y > 14 && y < h - 4;
    const labels = new Map([["camera", at(tree.nodes[0].origin)]]);
    for (const node of tree.nodes)
        for (const lamp of node.position ? node.lamps : []) // a lamp outside the view: where its ray leaves the view
            for (let t = 1; t > 0 && counts(lamp) && !labels.has(lamp.lamp); t -= 0.02) {
                const place = at(node.position.map((x, k) => x + t * (lamp.point[k] - x)));
                if (inside(place)) labels.set(lamp.lamp, place);
            }
    for (const [name, [x, y]] of labels) g.fillText(name, x + 4, y - 4);
}

function turn(yaw, pitch, zoom = 1) {
    view.yaw += yaw;
    view.pitch = Math.max(-1.57, Math.min(1.57, view.pitch + pitch));
    view.zoom *= zoom;
    showOutside();
}

function listen() {
    const canvas = find("outside");
    canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", event => { if (event.buttons) turn(-event.movementX / 150, event.movementY / 150); });
    canvas.addEventListener("wheel", event => { event.preventDefault(); turn(0, 0, Math.exp(-event.deltaY / 500)); }, { passive: false });
    const keys = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1], "+": [0, 0, 1.2], "-": [0, 0, 1 / 1.2] };
    canvas.addEventListener("keydown", event => { if (keys[event.key]) { event.preventDefault(); turn(...keys[event.key]); } });
    addEventListener("resize", () => { showOutside(); showBars(); });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", showOutside);
}

// ---------------------------------------------------------------- the samples

function showBars() {
    const order = light.map((_, i) => i).sort((a, b) => light[b] - light[a]);
    const n = order.length, most = Math.max(...light, 1e-30), stored = new Map(data.trees.map(one => [one.sample, one]));
    const wide = find("bars").clientWidth || 640;
    const drawing = svg("svg", { viewBox: `0 -10 ${wide} 180`, width: "100%", role: "img", "aria-label": "Samples, the brightest first" });
    order.forEach((i, rank) => {
        const w = wide / n, height = Math.max(150 * Math.max(light[i], 0) / most, 1);
        const bar = svg("rect", { x: rank * w, y: 160 - height, width: Math.max(w * 0.85, 0.5), height, fill: css(stored.has(i) ? "--accent" : "--line"), opacity: i === tree.sample || !stored.has(i) ? 1 : 0.6 });
        bar.append(svg("title", {}, `Sample ${i}: ${list(data.values[i])}`));
        if (stored.has(i)) bar.addEventListener("click", () => choose(stored.get(i)));
        drawing.append(bar);
    });
    drawing.append(svg("line", { x1: 0, x2: wide, y1: 160 - 150 * mean / most, y2: 160 - 150 * mean / most, stroke: css("--ink"), "stroke-dasharray": "4 3" }));
    drawing.append(svg("text", { x: wide - 2, y: 156 - 150 * mean / most, "text-anchor": "end" }, "mean"));
    find("bars").replaceChildren(drawing);
    find("list").replaceChildren(...data.trees.map(one => {
        const button = html("button", `sample ${one.sample}: ${list(data.values[one.sample])}`);
        button.setAttribute("aria-pressed", one === tree);
        button.addEventListener("click", () => choose(one));
        return button;
    }));
    const greatest = errors.toSorted((a, b) => b - a), all = sum(errors);
    let count = 0;
    for (let part = 0; part < 0.9 * all; count++) part += greatest[count];
    find("error").textContent = Object.keys(data.shares).length ? `${count} of ${n} samples make 90 % of the squared error; the worst three make ${Math.round(100 * sum(greatest.slice(0, 3)) / all)} %.` : "";
}

/** Shows a tree, and scrolls to it. */
function choose(one) {
    tree = one;
    showAll();
    find("list").querySelector("[aria-pressed=true]").focus({ preventScroll: true });
    find("tree").scrollIntoView({ block: "nearest" });
}

function showAll() {
    showImage(); showTree(); showOutside(); showBars();
    showNode(tree.nodes.reduce((a, b) => sum(b.contribution) > sum(a.contribution) ? b : a)); // the brightest one
}

document.title = find("title").textContent = `Pixel ${data.pixel.join(", ")} of ${data.name}`;
find("sum").textContent = `${data.channels.join(" ")} = ${list(data.mean)}, the mean of ${data.values.length} samples (seed ${data.seed}); the image has ${data.size.join(" × ")} pixels`;
find("command").textContent = data.command;
for (const name of ["notes", "light", "noise"])
    find(name).append(...data[name].map(text => html("p", text)));
find("pass").hidden = !data.n;
showAll();
listen();
