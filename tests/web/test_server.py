import http.client
import subprocess
import sys

import pytest

from iits_mj.core.errors import InputError
from iits_mj.web import WebServer

pytest.importorskip("viser")
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect


@pytest.fixture(scope="module")
def server():
    with WebServer(port=0, title="a test") as made:
        yield made


def get(server, path):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    connection.request("GET", path)
    answer = connection.getresponse()
    return answer, answer.read().decode()


def test_the_page_needs_the_token(server):
    answer, text = get(server, f"/{server.token}/")
    assert answer.status == 200
    assert "<title>a test</title>" in text
    assert "cockpit.js" in text
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    for path in ("/", "/index.html", "/cockpit.js", f"/{server.token[:-1]}/", "/x/", "//"):
        answer, text = get(server, path)
        assert answer.status == 403
        assert server.token not in text


def test_an_address_without_its_last_slash_leads_to_the_page(server):
    answer, _ = get(server, f"/{server.token}")
    assert answer.status == 301
    assert answer.headers["Location"] == f"/{server.token}/"


@pytest.mark.parametrize("name", ["cockpit.js", "cockpit.css"])
def test_script_and_style_are_served(server, name):
    answer, text = get(server, f"/{server.token}/{name}")
    assert answer.status == 200
    assert len(text) > 500


@pytest.mark.parametrize("path", ["..%2f..%2fserver.py", "../server.py", "nothing"])
def test_no_other_file_is_served(server, path):
    assert get(server, f"/{server.token}/{path}")[0].status == 404


@pytest.mark.parametrize("path", ["", "/", "/cockpit", "/wrong/cockpit", "/wrong"])
def test_a_websocket_without_the_token_is_refused(server, path):
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://127.0.0.1:{server.port}{path}", subprotocols=["viser-v0"])
    assert refused.value.response.status_code == 403


def talk(server):
    return connect(f"ws://127.0.0.1:{server.port}/{server.token}/cockpit")


def test_pages_get_their_number_and_the_newest_message_of_each_kind(server):
    server.tell("state", {"speed": "12"})
    server.tell("state", {"speed": "13"})
    with talk(server) as first, talk(server) as second:
        numbers = {first.recv(timeout=30), second.recv(timeout=30)}
        assert len(numbers) == 2
        for page in (first, second):
            assert page.recv(timeout=30) == '{"kind": "state", "content": {"speed": "13"}}'
        server.tell("other", 1)
        for page in (first, second):
            assert page.recv(timeout=30) == '{"kind": "other", "content": 1}'


def test_messages_that_are_no_objects_are_ignored(server):
    class Page:
        def __init__(self):
            self.seen, self.gone = [], []

        def message(self, page, content):
            self.seen.append(content)

        def left(self, page):
            self.gone.append(page)

    server.page = page = Page()
    with talk(server) as socket:
        for text in ("nonsense", "[1]", b"\xff", "x" * 5000, '{"a": 1}'):
            socket.send(text)
        server.tell("done", 0)
        while '"done"' not in socket.recv(timeout=30):
            pass
        socket.ping().wait(30)
    assert page.seen == [{"a": 1}]
    server.page = None


def test_the_instructions_name_the_address_and_the_port_forward(server):
    text = server.instructions()
    assert f"http://127.0.0.1:{server.port}/{server.token}/" in text
    assert f"ssh -L {server.port}:127.0.0.1:{server.port} " in text


def test_tokens_are_long_and_differ():
    with WebServer(port=0, title="one") as one, WebServer(port=0, title="two") as two:
        assert one.token != two.token
        assert min(len(one.token), len(two.token)) >= 22
        assert one.port != two.port


def test_an_address_of_another_machine_is_an_error():
    with pytest.raises(InputError, match=r"192\.0\.2\.1"):
        WebServer("192.0.2.1", 0, title="a test")


def test_importing_the_package_loads_no_viser():
    code = (
        "import sys, iits_mj.web, iits_mj.commands.view, iits_mj.web.live, iits_mj.web.playback;"
        "print([name for name in ('viser', 'mjviser', 'trimesh', 'websockets') "
        "if name in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_a_missing_viser_is_one_clear_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "mjviser", None)
    with pytest.raises(InputError, match="pip install viser mjviser"):
        WebServer(port=0, title="a test")
