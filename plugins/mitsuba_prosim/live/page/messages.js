// Shows messages of the translator: sentences wrap; quoted lines of the scene and the carets below them do not wrap.

/** Writes messages into an element, unless the element already shows these messages. */
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

/** Scrolls each quoted line that is too long, so that its caret is visible. */
export function showCarets(box) {
    for (const quoted of box.querySelectorAll("pre")) {
        const lines = quoted.textContent.split("\n"), caret = Math.max(...lines.map((line) => line.search(/\^~*\s*$/)));
        const width = quoted.scrollWidth / Math.max(...lines.map((line) => line.length));
        quoted.scrollLeft = width * caret - quoted.clientWidth / 2;
        if (quoted.scrollWidth > quoted.clientWidth) quoted.tabIndex = 0; // so that keys can scroll the line
        else quoted.removeAttribute("tabindex");
    }
}
