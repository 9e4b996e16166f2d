"""Opens many connections and sends nothing, or half a head, until the server has closed all; prints what it sees.

Arguments: port, number of connections. Lines: ``open``, then the number that the server closed.
"""

import resource
import selectors
import socket
import sys
import time

LONGEST_S = 60.0
HALF = b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: "


def report(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    port, count = int(sys.argv[1]), int(sys.argv[2])
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(count + 100, hard), hard))
    selector = selectors.DefaultSelector()
    for number in range(count):
        connection = socket.create_connection(("127.0.0.1", port), LONGEST_S)
        if number % 2:
            connection.send(HALF)
        connection.setblocking(False)
        selector.register(connection, selectors.EVENT_READ)
    report("open")
    end, left = time.monotonic() + LONGEST_S, count
    while left and time.monotonic() < end:
        for key, _ in selector.select(1.0):
            try:
                data = key.fileobj.recv(1000)
            except ConnectionError:
                data = b""
            if not data:
                selector.unregister(key.fileobj)
                key.fileobj.close()
                left -= 1
    report(str(count - left))


if __name__ == "__main__":
    main()
