// The state of the server, received as server-sent events.

// Milliseconds between two requests of a hidden page.
const INTERVAL_HIDDEN = 3000;

/** Calls `receive(state)` with the current state and with each newer state. Calls `lost(refused)` if the connection is lost;
 * `refused` is true if it cannot be restored. A hidden page requests the state at intervals instead of keeping a connection,
 * because a browser limits the number of connections to one server. */
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
