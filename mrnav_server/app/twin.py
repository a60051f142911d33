"""``/ws/twin``: a snapshot, then sampled states and every event; asks and heartbeats come back.

Each client has its own place in the newest-wins stream, so nobody waits for anybody.
"""

import asyncio
import logging
import secrets
from typing import Any

import orjson
from fastapi import WebSocket, WebSocketDisconnect
from pydantic import TypeAdapter, ValidationError

from mrnav_server.app import connections
from mrnav_server.app.auth import OPERATORS_ONLY, Principal, Role, session_name
from mrnav_server.app.page_hand import PageHand, lease_fields
from mrnav_server.app.problems import ApiError
from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.schemas import AskMessage, GiveHand, Heartbeat, TakeHand, TwinMessage
from mrnav_server.app.twin_states import TwinStates
from mrnav_server.core.errors import RefusedError, WireError
from mrnav_server.core.peer_limits import TokenBucket
from mrnav_server.loops.events import LaggingReaderError, Subscription

_MAX_CLIENTS = 128
_MESSAGES_PER_S = 120.0
_MAX_WAITING_ASKS = 8
_MESSAGE: TypeAdapter[Heartbeat | AskMessage | TakeHand | GiveHand] = TypeAdapter(TwinMessage)
_log = logging.getLogger(__name__)


class TwinHub:
    """Serves the twin stream to many clients.

    Args:
        rig: The rig.
    """

    def __init__(self, rig: RigPort) -> None:
        self._rig = rig
        self._states = TwinStates(rig)
        self.clients = 0
        self.slow_readers = 0

    async def serve(self, websocket: WebSocket, principal: Principal, rate_hz: float) -> None:
        """Talk to one client until it leaves, lags or breaks the protocol.

        Args:
            websocket: Not yet accepted.
            principal: Its role is checked for every message.
            rate_hz: States a second at most.

        Raises:
            ApiError: 503 if too many clients are connected.
        """
        if self.clients >= _MAX_CLIENTS:
            raise ApiError(503, "too_many_clients", f"{_MAX_CLIENTS} clients watch already")
        self.clients += 1
        client = _Client(self._rig, websocket, principal.role)
        try:
            await websocket.accept()
            write = connections.frame_writer(websocket.scope)
            with self._rig.events.subscribe() as events:
                # Whoever waits for a connection must not wait for the first state too.
                await client.send(orjson.dumps(client.snapshot()).decode())
                async with self._states.sent_to(write, rate_hz) as group:
                    group.create_task(client.send_events(events), name="twin events")
                    group.create_task(client.receive(), name="twin messages")
                    group.create_task(client.obey(), name="twin asks")
                    group.create_task(client.send_hand_news(), name="hand news")
        except* WebSocketDisconnect:
            pass
        except* (TimeoutError, LaggingReaderError):
            # No close frame: it would wait behind what this client does not read.
            self.slow_readers += 1
            _log.warning("a twin client that did not read for %g s was dropped", connections.SLOW_READER_S)
        except* WireError as errors:
            await client.close(errors)
        finally:
            client.hand.leave()
            self.clients -= 1


class _Client:
    """One connection: sends within a time limit, checks each message that comes."""

    def __init__(self, rig: RigPort, websocket: WebSocket, role: Role) -> None:
        self._rig = rig
        self._websocket = websocket
        self._role = role
        self._secret = f"page-{secrets.token_urlsafe(16)}"
        self._session = session_name(self._secret, role)
        self._bucket = TokenBucket(_MESSAGES_PER_S, _MESSAGES_PER_S)
        self._asks: asyncio.Queue[AskMessage] = asyncio.Queue(_MAX_WAITING_ASKS)
        self._hand_news: asyncio.Queue[dict[str, object]] = asyncio.Queue()
        self.hand = PageHand(rig.hand_seat, lambda *news: self._hand_news.put_nowait(lease_fields(*news)))

    def snapshot(self) -> dict[str, Any]:
        # Pages know two roles; what a chief may do besides is asked for over REST.
        role = min(self._role, Role.OPERATOR).name.lower()
        own = {"session": self._secret, "seat": self._session, "chief": self._role >= Role.CHIEF}
        return {**self._rig.snapshot(self._session, role), **own}

    async def send(self, text: str) -> None:
        async with asyncio.timeout(connections.SLOW_READER_S):
            try:
                await self._websocket.send_text(text)
            except RuntimeError:
                # The server closed it meanwhile: the client did not answer its pings.
                raise WebSocketDisconnect(1006) from None

    async def send_events(self, events: Subscription) -> None:
        while True:
            await self.send(orjson.dumps(await events.get()).decode())

    async def send_hand_news(self) -> None:
        while True:
            await self.send(orjson.dumps(await self._hand_news.get()).decode())

    async def receive(self) -> None:
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(message.get("code", 1005))
            if not self._bucket.take(asyncio.get_running_loop().time()):
                raise WireError("flood", f"more than {_MESSAGES_PER_S:.0f} messages a second")
            text = message.get("text")
            if text is None:
                raise WireError("bad_message", "messages are text")
            content = _json(text)
            if isinstance(content, dict) and content.get("type") == "hand":
                self.hand.take(text.encode())
            else:
                await self._take(_checked(content))

    async def obey(self) -> None:
        """Pass the asks on in their order; one that plans a path takes a while, and nothing else waits."""
        while True:
            ask = await self._asks.get()
            try:
                await self._rig.console.ask(ask.ask, self.hand.session or self._session, ask.area)
            except RefusedError as error:
                await self._answer(error.code, str(error))
            else:
                await self._answer("ok")

    async def _take(self, message: Heartbeat | AskMessage | TakeHand | GiveHand) -> None:
        """Do at once what is urgent, check the role, and leave the rest to ``obey``."""
        if isinstance(message, AskMessage) and message.ask == "stop":
            self._rig.console.stop_now(self._session)  # anyone may stop
            await self._answer("ok")
        elif isinstance(message, TakeHand | GiveHand):
            refused = lease_fields(False, "forbidden", OPERATORS_ONLY)
            answer = self.hand.answer(message) if self._role >= Role.OPERATOR else refused
            self._hand_news.put_nowait(answer)
        elif self._role < Role.OPERATOR:
            await self._answer("forbidden", OPERATORS_ONLY)
        elif isinstance(message, Heartbeat):
            self._rig.console.heartbeat(self._session)
        elif self._asks.full():
            await self._answer("busy", f"{self._asks.maxsize} asks wait already: wait for their answers")
        else:
            self._asks.put_nowait(message)

    async def _answer(self, code: str, text: str = "") -> None:
        answer = {"type": "answer", "ok": code == "ok", "code": code, "message": text}
        await self.send(orjson.dumps(answer).decode())

    async def close(self, errors: BaseExceptionGroup[WireError]) -> None:
        reason = "; ".join(
            f"{error.code}: {error}" for error in errors.exceptions if isinstance(error, WireError)
        )
        async with asyncio.timeout(connections.SLOW_READER_S):
            await self._websocket.close(1008, reason.encode()[:120].decode(errors="ignore"))


def _json(text: str) -> object:
    try:
        # orjson refuses what json lets through: NaN, Infinity, 1e999, endless nesting.
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        raise WireError("bad_json", "the message is not JSON") from None


def _checked(content: object) -> Heartbeat | AskMessage | TakeHand | GiveHand:
    try:
        return _MESSAGE.validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        field = ".".join(str(part) for part in first["loc"]) or "message"
        raise WireError("bad_message", f"{field}: {first['msg']}") from None
