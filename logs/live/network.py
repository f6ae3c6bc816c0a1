"""Connect to a running robot through a zenoh router: announced topics and received messages."""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from functools import partial
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import TYPE_CHECKING, Any

from logs.errors import LogError
from logs.live.keys import (
    NO_HASH,
    PublishedTopic,
    data_key,
    parse_token,
    publisher_tokens,
    tokens_of,
    type_hash,
)
from logs.ros.definitions import typestore

if TYPE_CHECKING:
    import zenoh

DEFAULT_ROUTER, DEFAULT_PORT = "127.0.0.1", 7447
CONNECT_TIMEOUT = 3.0
"""[s] time in which the router must answer."""
FIRST_RETRY, LONGEST_RETRY = 0.1, 0.5
"""[s] delay between attempts to reach a lost router: the first delay is doubled up to the longest one."""
ATTACHMENT_SIZE = 33
"""[bytes] size of the attachment of rmw_zenoh: 8 of sequence, 8 of time, 1 of length, 16 of publisher id."""


@dataclass(frozen=True, kw_only=True)
class LiveMessage:
    """One received message."""

    topic: PublishedTopic
    received_ns: int
    payload: bytes
    """CDR, as sent."""
    publisher: bytes = b""
    sequence: int | None = None
    """Sequence number of its publisher; None if not sent."""


class RosNetwork:
    """The topics of a robot, received through the router of its nodes.

    If the router is lost later, the connection is retried without a limit, and all subscriptions resume.

    Parameters
    ----------
    router : HOST, HOST:PORT, or a zenoh endpoint such as tcp/192.168.0.5:7447
    domain : ROS_DOMAIN_ID; None: from the environment, otherwise 0
    wait : [s] time in which the router must answer; None: CONNECT_TIMEOUT

    Raises
    ------
    LogError
        If zenoh is not installed, no router answers in time, or the domain is not a number.
    """

    def __init__(
        self, router: str = DEFAULT_ROUTER, domain: int | None = None, *, wait: float | None = None
    ) -> None:
        self.router = endpoint_of(router)
        self.domain = _domain() if domain is None else domain
        self.topics: dict[str, PublishedTopic] = {}
        """Name -> topic announced since the connection was opened."""
        self._inbox: SimpleQueue[LiveMessage | PublishedTopic] = SimpleQueue()
        self._subscribers: dict[str, Any] = {}
        self._publishers: dict[str, LivePublisher] = {}
        self._has_hashes = False
        self._session = _open(self.router, CONNECT_TIMEOUT if wait is None else wait)
        self._session.liveliness().declare_subscriber(tokens_of(self.domain), self._on_token, history=True)

    @property
    def is_connected(self) -> bool:
        """Whether the router answers."""
        return bool(self._session.info.routers_zid() or self._session.info.peers_zid())

    def listen(self, topic: PublishedTopic) -> None:
        """Subscribe to a topic; a latched topic also delivers its earlier messages."""
        if topic.name in self._subscribers:
            return
        zenoh = _zenoh()
        receive = partial(self._on_sample, topic)
        key = data_key(self.domain, topic)
        if topic.is_latched or topic.name.rstrip("/").endswith("tf_static"):
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            subscriber: Any = zenoh.ext.declare_advanced_subscriber(
                self._session, key, receive, history=history
            )
        else:
            subscriber = self._session.declare_subscriber(key, receive)
        self._subscribers[topic.name] = subscriber

    def next(self, until: float) -> LiveMessage | PublishedTopic | None:
        """Return the next message or announcement in order of arrival; None after the timeout.

        Parameters
        ----------
        until : [s] of `time.monotonic` at which waiting ends; queued items are returned even later
        """
        try:
            item = self._inbox.get(timeout=max(until - time.monotonic(), 1e-4))
        except Empty:
            return None
        if isinstance(item, PublishedTopic):
            self.topics[item.name] = item
        return item

    def publish(self, topic: PublishedTopic, payload: bytes) -> None:
        """Publish a message (CDR), announced as a publisher of rmw_zenoh."""
        if topic.name not in self._publishers:
            text = typestore().hash_rihs01(topic.type) if self._has_hashes else NO_HASH
            self._publishers[topic.name] = LivePublisher(
                self._session, self.domain, len(self._publishers) + 1, topic, text
            )
        self._publishers[topic.name].put(payload)

    def close(self) -> None:
        """Close the connection; items already received remain available from `next`."""
        for subscriber in self._subscribers.values():
            subscriber.undeclare()
        self._subscribers.clear()
        self._session.close()

    def __enter__(self) -> RosNetwork:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _on_sample(self, topic: PublishedTopic, sample: zenoh.Sample) -> None:
        self._inbox.put(_message(topic, sample))

    def _on_token(self, sample: zenoh.Sample) -> None:
        topic = parse_token(str(sample.key_expr))
        if topic is not None and sample.kind == _zenoh().SampleKind.PUT:
            self._has_hashes |= type_hash(str(sample.key_expr)) != NO_HASH
            self._inbox.put(topic)


class LivePublisher:
    """Publisher of one topic, with the attachment of rmw_zenoh."""

    def __init__(self, session: Any, domain: int, number: int, topic: PublishedTopic, hash_text: str) -> None:
        key = data_key(domain, topic).removesuffix("*") + hash_text
        self._publisher = session.declare_publisher(key)
        tokens = publisher_tokens(domain, str(session.info.zid()), number, topic, hash_text)
        self._tokens = [session.liveliness().declare_token(token) for token in tokens]
        self._id = os.urandom(16)
        self._count = 0

    def put(self, payload: bytes) -> None:
        """Publish one message."""
        self._count += 1
        head = self._count.to_bytes(8, "little") + time.time_ns().to_bytes(8, "little") + bytes([16])
        self._publisher.put(payload, attachment=head + self._id)


def endpoint_of(router: str) -> str:
    """Return the zenoh endpoint of HOST, HOST:PORT or an endpoint."""
    if "/" in router:
        return router
    host, colon, port = router.rpartition(":")
    return f"tcp/{router}" if colon and port.isdigit() and host else f"tcp/{router}:{DEFAULT_PORT}"


def _open(endpoint: str, wait: float) -> Any:
    zenoh = _zenoh()
    until = time.monotonic() + wait
    while True:
        config = zenoh.Config()
        one_try = min(max(until - time.monotonic(), 0.1), CONNECT_TIMEOUT)
        try:
            for key, value in _settings(endpoint, one_try).items():
                config.insert_json5(key, json.dumps(value))
            return zenoh.open(config)
        except zenoh.ZError as exc:
            if time.monotonic() < until:
                continue
            raise LogError(
                f"no zenoh router answers at {endpoint}; start one on the robot (ros2 run rmw_zenoh_cpp rmw_zenohd, "
                "its nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp), or set its address: `router` HOST:PORT"
            ) from exc


def _settings(endpoint: str, timeout: float) -> dict[str, Any]:
    return {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": round(timeout * 1e3),
        "connect/retry": {
            "period_init_ms": round(FIRST_RETRY * 1e3),
            "period_max_ms": round(LONGEST_RETRY * 1e3),
            "period_increase_factor": 2,
        },
        "scouting/multicast/enabled": False,
    }


def _domain() -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdigit():
        raise LogError(f"ROS_DOMAIN_ID is {text!r}, expected an integer; correct it, or set `domain`")
    return int(text)


def _message(topic: PublishedTopic, sample: zenoh.Sample) -> LiveMessage:
    attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
    is_known = len(attachment) == ATTACHMENT_SIZE
    return LiveMessage(
        topic=topic,
        received_ns=time.time_ns(),
        payload=sample.payload.to_bytes(),
        publisher=attachment[17:] if is_known else b"",
        sequence=int.from_bytes(attachment[:8], "little") if is_known else None,
    )


def _zenoh() -> Any:
    try:
        import zenoh
        import zenoh.ext
    except ImportError as exc:
        raise LogError(
            "recording a running robot needs zenoh; install it with: pip install eclipse-zenoh"
        ) from exc
    return zenoh
