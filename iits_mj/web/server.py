"""Web server of the viewer: viser's page and messages, and our own, behind one secret address.

Everything is served below `/TOKEN/` of one port: the page, its script and style, viser's websocket
and the websocket of instruments and driving. Requests without the token are refused, websockets
included. viser's client takes the address of its websocket from that of its page.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hmac
import http
import io
import itertools
import json
import secrets
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError

if TYPE_CHECKING:
    import viser

PORT = 8080
TALK = "cockpit"  # path of our websocket
_PAGE = Path(__file__).parent / "page"
_FILES = {"cockpit.js": "text/javascript", "cockpit.css": "text/css"}
_LINKS = '<link rel="stylesheet" href="cockpit.css"><script defer src="cockpit.js"></script>'
_REFUSED = "The token is missing or wrong: open the address that 'iits-mj view --web' printed.\n"
# Longest message of a page [bytes]: the inputs of a driver are about 100.
_LONGEST = 4096


def load_viser() -> Any:
    """Returns the module `viser`.

    Raises:
      InputError: viser or mjviser is missing.
    """
    try:
        import mjviser  # noqa: F401
        import viser
    except ImportError as error:
        raise InputError(
            f"the web viewer needs viser and mjviser ({error}): pip install viser mjviser"
        ) from error
    return viser


class Page(Protocol):
    """What a page in a browser does; the methods are called in the server's thread."""

    def message(self, page: int, content: dict[str, Any]) -> None:
        """Receives a message from a page; pages are numbered from 1."""

    def left(self, page: int) -> None:
        """Forgets a page that was closed."""


class WebServer(Closing):
    """Serves viewers until it is closed.

    Args:
      host: address to listen on.
      port: the first port to try; 0 for any free one.
      title: of the page.
      token: secret in the address; default: a new one.

    Attributes:
      viser: the scene and its panel, the same for all viewers.
      page: receives the messages of the pages; None: nobody.
      port: that is used; token, host: the arguments.

    Raises:
      InputError: viser is missing, or the server cannot listen there.
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = PORT, *, title: str, token: str | None = None
    ) -> None:
        load_viser()
        self.host, self.token = host, token or secrets.token_urlsafe(16)
        self.page: Page | None = None
        self._pages: dict[int, Any] = {}
        self._numbers = itertools.count(1)
        self._newest: dict[str, str] = {}
        # asyncio itself keeps only weak references to tasks.
        self._sending: set[asyncio.Future[None]] = set()
        self._title = title
        self.viser: viser.ViserServer = self._start(port)
        self.port: int = self.viser.get_port()
        self._loop = self.viser.get_event_loop()

    @property
    def url(self) -> str:
        """Address of the page, as seen on this machine."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::") else self.host
        return f"http://{host}:{self.port}/{self.token}/"

    def instructions(self) -> str:
        """Returns how to open the page here, and from another machine."""
        import getpass
        import socket

        try:
            user = getpass.getuser()
        except (KeyError, OSError):
            user = "USER"
        lines = [f"open {self.url}"]
        if self.host == "127.0.0.1":
            forward = f"ssh -L {self.port}:127.0.0.1:{self.port} {user}@{socket.gethostname()}"
            lines.append(f"from another machine, first: {forward}")
        return "\n".join(lines)

    def tell(self, kind: str, content: Any) -> None:
        """Sends a message to all pages; pages opened later get the newest one of each kind.

        A page that is slow to receive misses messages.
        """
        text = json.dumps({"kind": kind, "content": content}, allow_nan=False)
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._send, kind, text)

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return bool(self._pages)

    def close(self) -> None:
        """Ends the server; pages show that the connection is lost."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.viser.stop()

    def _start(self, port: int) -> Any:
        """Starts viser with our check before its own handlers.

        viser offers no place for it: the function that it calls to listen is replaced meanwhile.
        """
        import viser
        from viser import _messages
        from websockets.asyncio import server as listener

        original = listener.serve
        listening = threading.Event()

        @functools.wraps(original)
        def serve(handler: Any, host: str, port: int, **settings: Any) -> Any:
            serve_file = settings.pop("process_request")
            listening.set()
            return original(
                functools.partial(self._connect, handler),
                host,
                port,
                process_request=functools.partial(self._request, serve_file),
                **settings,
            )

        listener.serve = serve  # type: ignore[assignment, misc]
        try:
            # viser prints addresses without the token.
            with contextlib.redirect_stdout(io.StringIO()), _port_errors(self.host):
                made = viser.ViserServer(host=self.host, port=port, label="iits_mj", verbose=False)
        finally:
            listener.serve = original  # type: ignore[misc]
        assert listening.is_set(), "viser listens in another way than expected"
        # Nobody may make the page public through viser's relay.
        for kind in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            made._websock_server.unregister_handler(kind)
        made.gui.configure_theme(show_share_button=False, show_logo=False, control_width="small")
        return made

    def _request(self, serve_file: Callable[..., Any], connection: Any, request: Any) -> Any:
        """Returns a response, None to accept a websocket."""
        path = request.path.partition("?")[0].lstrip("/")
        token, slash, rest = path.partition("/")
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return connection.respond(http.HTTPStatus.FORBIDDEN, _REFUSED)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return None
        if not slash:
            response = connection.respond(http.HTTPStatus.MOVED_PERMANENTLY, "")
            response.headers["Location"] = f"/{self.token}/"
            return response
        if rest in _FILES:
            response = connection.respond(http.HTTPStatus.OK, (_PAGE / rest).read_text("utf-8"))
            _set(response, "Content-Type", f"{_FILES[rest]}; charset=utf-8")
        elif rest in ("", "index.html"):
            response = connection.respond(http.HTTPStatus.OK, self._index())
            _set(response, "Content-Type", "text/html; charset=utf-8")
        else:
            request.path = f"/{rest}"
            response = serve_file(connection, request)
        _set(response, "Cache-Control", "no-store")
        _set(response, "Referrer-Policy", "no-referrer")
        return response

    def _index(self) -> str:
        import viser

        page = Path(viser.__file__).parent / "client" / "build" / "index.html"
        text = page.read_text("utf-8").replace("<title>Viser</title>", "", 1)
        title = f"<title>{self._title}</title>"
        return text.replace("</head>", f"{title}{_LINKS}</head>", 1)

    async def _connect(self, handler: Callable[[Any], Any], connection: Any) -> None:
        """Serves one websocket until it is closed."""
        path = connection.request.path.partition("?")[0]
        if path.rstrip("/").endswith(f"/{TALK}"):
            await self._talk(connection)
        else:
            await handler(connection)

    async def _talk(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        number = next(self._numbers)
        try:
            await connection.send(json.dumps({"kind": "page", "content": number}))
            for text in self._newest.values():
                await connection.send(text)
            self._pages[number] = connection
            async for received in connection:
                content = _parsed(received)
                if content is not None and self.page is not None:
                    self.page.message(number, content)
        except ConnectionClosed:
            pass
        finally:
            self._pages.pop(number, None)
            if self.page is not None:
                self.page.left(number)

    def _send(self, kind: str, text: str) -> None:
        self._newest[kind] = text
        for connection in list(self._pages.values()):
            # A page that does not read would let the messages pile up.
            if connection.transport.get_write_buffer_size() < 2**18:
                task = asyncio.ensure_future(_deliver(connection, text))
                self._sending.add(task)
                task.add_done_callback(self._sending.discard)


async def _deliver(connection: Any, text: str) -> None:
    from websockets.exceptions import ConnectionClosed

    with contextlib.suppress(ConnectionClosed):
        await connection.send(text)


def _parsed(received: str | bytes) -> dict[str, Any] | None:
    """Returns a page's message; None if it is none."""
    if len(received) > _LONGEST:
        return None
    try:
        content = json.loads(received)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


def _set(response: Any, name: str, value: str) -> None:
    if name in response.headers:
        del response.headers[name]
    response.headers[name] = value


@contextlib.contextmanager
def _port_errors(host: str) -> Iterator[None]:
    """Turns viser's endless wait for an address that is not this machine's into an error."""
    import socket

    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        with socket.socket(found[0][0], socket.SOCK_STREAM) as probe:
            probe.bind(found[0][4])
    except OSError as error:
        raise InputError(f"--host {host!r}: cannot listen there: {error.strerror}") from error
    yield
