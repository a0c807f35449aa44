// Pan and zoom of the picture by pointers, the wheel and keys.

// A pointer that moves by fewer pixels than this is a click.
const CLICK = 3;

/** Moves and zooms the picture. If `camera()` is true, calls `gesture(kind, x, y)` instead: orbit in degrees, pan in
 * fractions of the picture, dolly as a factor. Calls `point(pixel)` when the pointer is at a pixel, and `explain(pixel)`
 * after a click and after Enter. */
export class PanZoom {
    constructor(stage, picture, {camera, gesture, point, explain}) {
        Object.assign(this, {stage, picture, camera, gesture, point, explain, width: 1, height: 1, zoom: 1, x: 0, y: 0, fitted: true});
        this.pointers = new Map();
        stage.addEventListener("pointerdown", (e) => this.down(e));
        stage.addEventListener("pointermove", (e) => this.move(e));
        stage.addEventListener("pointerup", (e) => this.up(e));
        stage.addEventListener("pointercancel", (e) => this.pointers.delete(e.pointerId));
        stage.addEventListener("wheel", (e) => this.wheel(e), {passive: false});
        stage.addEventListener("contextmenu", (e) => this.camera() && e.preventDefault());
        stage.addEventListener("keydown", (e) => this.key(e));
        new ResizeObserver(() => this.fitted ? this.fit() : this.update()).observe(stage);
    }

    resize(width, height) {
        if (width === this.width && height === this.height) return;
        [this.width, this.height] = [width, height];
        this.fit();
    }

    fittingZoom() {
        const {width, height} = this.stage.getBoundingClientRect(); // clientWidth is rounded
        return Math.min(width / this.width, height / this.height) || 1;
    }

    fit() {
        this.zoom = this.fittingZoom();
        this.centre();
        this.fitted = true;
    }

    actual() {
        this.zoom = 1 / devicePixelRatio;
        this.centre();
    }

    centre() {
        const {width, height} = this.stage.getBoundingClientRect();
        this.x = (width - this.zoom * this.width) / 2;
        this.y = (height - this.zoom * this.height) / 2;
        this.update();
    }

    update() {
        this.picture.style.width = `${this.zoom * this.width}px`;
        this.picture.style.height = `${this.zoom * this.height}px`;
        // Without a transform the pixels of the picture align with those of the screen.
        this.picture.style.left = `${this.x}px`;
        this.picture.style.top = `${this.y}px`;
        this.picture.classList.toggle("large", this.zoom * devicePixelRatio >= 2);
    }

    shift(dx, dy) {
        this.fitted = false;
        // A part of the picture always stays visible.
        const keep = 40, {clientWidth, clientHeight} = this.stage;
        this.x = Math.min(Math.max(this.x + dx, keep - this.zoom * this.width), clientWidth - keep);
        this.y = Math.min(Math.max(this.y + dy, keep - this.zoom * this.height), clientHeight - keep);
        this.update();
    }

    scale(factor, x = this.stage.clientWidth / 2, y = this.stage.clientHeight / 2) {
        const zoom = Math.min(Math.max(this.zoom * factor, Math.min(0.02, this.fittingZoom())), Math.max(64, this.fittingZoom()));
        const ratio = zoom / this.zoom;
        this.zoom = zoom;
        this.shift((x - this.x) * (1 - ratio), (y - this.y) * (1 - ratio));
    }

    /** Returns the pixel of the picture at a position of the window, or null. */
    pixel(clientX, clientY) {
        const box = this.stage.getBoundingClientRect();
        const x = Math.floor((clientX - box.left - this.x) / this.zoom), y = Math.floor((clientY - box.top - this.y) / this.zoom);
        return x >= 0 && y >= 0 && x < this.width && y < this.height ? [x, y] : null;
    }

    down(e) {
        this.stage.focus({preventScroll: true});
        this.pointers.set(e.pointerId, {at: [e.clientX, e.clientY], still: true});
        try { this.stage.setPointerCapture(e.pointerId); } catch { /* the pointer was released meanwhile */ }
    }

    up(e) {
        const last = this.pointers.get(e.pointerId);
        this.pointers.delete(e.pointerId);
        if (!last?.still) return;
        this.point(this.pixel(e.clientX, e.clientY)); // without a mouse, a touch selects a pixel
        if (e.button === 0) this.explain(this.pixel(e.clientX, e.clientY));
    }

    move(e) {
        const pointer = this.pointers.get(e.pointerId);
        if (!pointer) {
            this.point(this.pixel(e.clientX, e.clientY));
            return;
        }
        const last = pointer.at, dx = e.clientX - last[0], dy = e.clientY - last[1];
        if (pointer.still && Math.hypot(dx, dy) < CLICK) return;
        const other = [...this.pointers].find(([id]) => id !== e.pointerId)?.[1].at;
        Object.assign(pointer, {at: [e.clientX, e.clientY], still: false});
        if (other) {
            const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
            const factor = Math.hypot(e.clientX - other[0], e.clientY - other[1]) / Math.max(before, 1);
            const box = this.stage.getBoundingClientRect();
            if (this.camera()) {
                this.gesture("dolly", 1 / Math.min(Math.max(factor, 0.2), 5), 0);
                this.gesture("pan", dx / 2 / (this.zoom * this.width), -dy / 2 / (this.zoom * this.height));
            } else {
                this.scale(factor, (e.clientX + other[0]) / 2 - box.left, (e.clientY + other[1]) / 2 - box.top);
                this.shift(dx / 2, dy / 2);
            }
        } else if (!this.camera()) this.shift(dx, dy);
        else if (e.shiftKey || e.buttons & 6) this.gesture("pan", dx / (this.zoom * this.width), -dy / (this.zoom * this.height));
        else this.gesture("orbit", -dx / 3, dy / 3);
    }

    wheel(e) {
        e.preventDefault();
        // The browser reports a pinch on a touchpad as a wheel event with Ctrl.
        const factor = Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : e.ctrlKey ? 0.01 : 0.0015));
        const box = this.stage.getBoundingClientRect();
        if (this.camera()) this.gesture("dolly", 1 / factor, 0);
        else this.scale(factor, e.clientX - box.left, e.clientY - box.top);
    }

    key(e) {
        if (e.target !== this.stage || e.ctrlKey || e.metaKey || e.altKey) return;
        const box = this.stage.getBoundingClientRect(), middle = () => this.pixel(box.left + box.width / 2, box.top + box.height / 2);
        const arrows = {ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[e.key];
        const factor = {"+": 1.25, "=": 1.25, "-": 0.8}[e.key];
        if (arrows && this.camera() && e.shiftKey) this.gesture("pan", 0.05 * arrows[0], -0.05 * arrows[1]);
        else if (arrows && this.camera()) this.gesture("orbit", -5 * arrows[0], 5 * arrows[1]);
        else if (arrows) this.shift(40 * arrows[0], 40 * arrows[1]);
        else if (factor && this.camera()) this.gesture("dolly", 1 / factor, 0);
        else if (factor) this.scale(factor);
        else if (e.key === "0") this.fit();
        else if (e.key === "1") this.actual();
        else if (e.key === "Enter") this.explain(middle());
        else return;
        e.preventDefault();
        if (!this.camera()) this.point(middle(), true);
    }
}
