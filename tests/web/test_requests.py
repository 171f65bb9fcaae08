import threading

from iits_mj.core.errors import InputError
from iits_mj.web.requests import Applied, Request, Requests


def test_requests_are_applied_in_their_order_and_kept_with_their_time():
    requests, seen = Requests(), []
    for number in range(3):
        requests.put("add", number)
    assert requests.apply({"add": seen.append}, time=1.5) == []
    assert seen == [0, 1, 2]
    assert requests.applied[1] == Applied(1.5, Request("add", 1))
    assert requests.empty


def test_a_request_that_cannot_be_applied_is_told_and_the_next_one_is_applied():
    def refuse(value):
        raise InputError(f"{value} is too much")

    requests, seen = Requests(), []
    requests.put("refuse", 7)
    requests.put("unknown")
    requests.put("add", 1)
    refused = requests.apply({"refuse": refuse, "add": seen.append}, time=0.0)
    assert refused == ["7 is too much", "'unknown' is not possible here"]
    assert seen == [1]
    assert [entry.request.name for entry in requests.applied] == ["add"]


def test_a_thread_that_waits_gets_the_request_of_another_one():
    requests, seen = Requests(), []
    threading.Timer(0.05, requests.put, ("add", 5)).start()
    requests.apply({"add": seen.append}, time=0.0, timeout=30.0)
    assert seen == [5]
