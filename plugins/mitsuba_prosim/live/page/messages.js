// Messages of the translator: sentences, which wrap, and quoted lines with their carets, which do not.

/** Writes messages into an element, unless it has them. */
export function showMessages(box, text) {
    if (box.dataset.text === text) return;
    box.dataset.text = text;
    box.replaceChildren();
    for (const line of text.split("\n").filter((line) => line.trim())) {
        const tag = /^\s/.test(line) ? "PRE" : "P";
        if (tag === "PRE" && box.lastChild?.tagName === tag) box.lastChild.textContent += `\n${line}`;
        else box.appendChild(document.createElement(tag)).textContent = line;
    }
    showCarets(box);
}

/** Scrolls quoted lines that are too long to their carets. */
export function showCarets(box) {
    for (const quoted of box.querySelectorAll("pre")) {
        const lines = quoted.textContent.split("\n"), caret = Math.max(...lines.map((line) => line.search(/\^~*\s*$/)));
        const width = quoted.scrollWidth / Math.max(...lines.map((line) => line.length));
        quoted.scrollLeft = width * caret - quoted.clientWidth / 2;
        if (quoted.scrollWidth > quoted.clientWidth) quoted.tabIndex = 0; // so that keys scroll it
        else quoted.removeAttribute("tabindex");
    }
}
