// The state of the server, received as server-sent events.

// Milliseconds between two requests of a hidden page.
const INTERVAL_HIDDEN = 3000;

/** Calls `receive(state)` with the state and each newer one, and `lost(refused)` if the connection is lost, `refused` if for
 * good. A hidden page only asks at intervals, because a browser limits the number of connections to one server. */
export function follow(receive, lost) {
    let events = null, timer = 0;

    function connect() {
        disconnect();
        events = new EventSource("events");
        events.onmessage = (e) => {
            receive(JSON.parse(e.data));
            if (!document.hidden) return;
            disconnect();
            timer = setTimeout(connect, INTERVAL_HIDDEN);
        };
        events.onerror = () => lost(events.readyState === EventSource.CLOSED);
    }

    function disconnect() {
        clearTimeout(timer);
        events?.close();
    }

    document.addEventListener("visibilitychange", connect);
    connect();
}
