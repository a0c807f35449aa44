// What the server says, for as long as it is there.

// Milliseconds: the time without an event after which the server counts as gone (it sends events more often); and the
// interval between two requests of a hidden page.
const SILENCE = 40000, SELDOM = 3000;

/** Calls `receive(state)` with the state and each newer one, and `lost(refused)` when nothing is heard: for good where it is
 * refused. A hidden page asks at intervals only: a browser has few connections for all its pages here. */
export function follow(receive, lost) {
    let events = null, silence = 0, again = 0;

    function listen() {
        stop();
        events = new EventSource("events");
        events.addEventListener("here", heard);
        events.onmessage = (e) => {
            heard();
            receive(JSON.parse(e.data));
            if (!document.hidden) return;
            stop();
            again = setTimeout(listen, SELDOM);
        };
        events.onerror = () => {
            const refused = events.readyState === EventSource.CLOSED;
            if (refused) stop(); // it is not asked again
            lost(refused);
        };
        heard();
    }

    function heard() {
        clearTimeout(silence);
        silence = setTimeout(() => { lost(false); listen(); }, SILENCE);
    }

    function stop() {
        clearTimeout(silence);
        clearTimeout(again);
        events?.close();
    }

    document.addEventListener("visibilitychange", listen);
    listen();
}
