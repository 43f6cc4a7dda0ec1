"""The web application: state as server-sent events, pictures, results, and commands."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pydantic_core import to_json
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from tumble.bench.state import State
from tumble.bench.station import STEP_SECONDS, Station
from tumble.bench.web import connections
from tumble.bench.web.access import HEADERS, Access
from tumble.programme.sheet import picture

PAGE = Path(__file__).parent / "page"
_KEEP_ALIVE = 1.0
_POLL_SECONDS = 0.25 * STEP_SECONDS
_YEAR = 365 * 86400
# not an HTTP redirection, which from a link in another page would return without the cookie
_ENTRY_PAGE = '<meta http-equiv="refresh" content="0; url=/">'
_MAX_COMMAND_BYTES = 4096
_COMMAND_SECONDS = 10.0  # in which the body of a command must arrive
_COMMANDS_AT_ONCE = 2  # one that takes minutes, and one that is meanwhile refused


def app_of(station: Station, access: Access) -> Starlette:
    """Return the application that serves the page of a station. Its `state.stopping` ends the event streams."""
    workers = ThreadPoolExecutor(_COMMANDS_AT_ONCE, thread_name_prefix="command")
    written: dict[tuple[int, bool], tuple[str, int]] = {}
    written_state: State = {}
    onlookers = 0

    async def guarded(request: Request, call: Callable[[Request], Awaitable[Response]]) -> Response:
        refused = _refusal(request, access)
        response = refused if refused is not None else await call(request)
        response.headers.update(HEADERS)
        return response

    async def page(_: Request) -> Response:
        return FileResponse(PAGE / "index.html", media_type="text/html; charset=utf-8")

    async def icon(_: Request) -> Response:
        return Response(status_code=204)

    def event(state: State, since: int, may_command: bool) -> tuple[str, int]:
        """Return a state with the block means from number `since` on as an event, and the number after the last.

        It is encoded once for all pages with the same `since`."""
        nonlocal written, written_state
        if state is not written_state:
            written, written_state = {}, state
        if (since, may_command) not in written:
            trace = station.trace(since)
            whole = to_json({**state, "trace": trace, "may_command": may_command}, inf_nan_mode="null")
            written[since, may_command] = f"data: {whole.decode()}\n\n", trace["next"]
        return written[since, may_command]

    async def events(request: Request) -> Response:
        nonlocal onlookers
        may_command = access.is_token(request.cookies.get(access.cookie))
        if not may_command and onlookers >= connections.max_connections() // 2:
            return _plain(503, "too many look on without the token that the server has printed")
        onlookers += not may_command

        async def stream() -> AsyncIterator[str]:
            nonlocal onlookers
            try:
                async for message in states():
                    yield message
            finally:
                onlookers -= not may_command

        async def states() -> AsyncIterator[str]:
            """Yield states as they change, and an empty event after a second without a change."""
            yield "retry: 500\n\n"
            before: State = {}
            since, sent = 0, 0.0
            while not app.state.stopping and not await request.is_disconnected():
                state = station.state
                if state is not before:
                    before = state
                    message, since = event(state, since, may_command)
                    yield message
                elif time.monotonic() - sent > _KEEP_ALIVE:
                    yield "event: here\ndata: \n\n"
                else:
                    await asyncio.sleep(_POLL_SECONDS)
                    continue
                sent = time.monotonic()

        return StreamingResponse(stream(), media_type="text/event-stream")

    async def drawing(request: Request) -> Response:
        task, number = station.task, int(request.path_params["number"])
        if task.programme is None or number >= len(task.programme.positions):
            return _plain(404, "no such position")
        return Response(picture(task.programme.positions[number], task.move(number)), media_type="image/svg+xml")

    async def result(request: Request) -> Response:
        name = request.path_params["name"]
        path = station.file(name)
        if path is None or not path.is_file():
            return _plain(404, "no such result")
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    async def command(request: Request) -> Response:
        try:
            given = json.loads(await _body(request))
            name, value = str(given["do"]), str(given.get("value", ""))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return _plain(400, "expected a command")
        outcome = await asyncio.get_running_loop().run_in_executor(workers, station.command, name, value)
        return Response(to_json({"said": outcome}), media_type="application/json")

    app = Starlette(
        routes=[
            Route("/", page),
            Route("/favicon.ico", icon),
            Route("/events", events),
            Route("/picture/{number:int}.svg", drawing),
            Route("/files/{name}", result),
            Route("/command", command, methods=["POST"]),
            Mount("/assets", StaticFiles(directory=PAGE)),
        ],
        middleware=[Middleware(BaseHTTPMiddleware, dispatch=guarded)],
    )
    app.state.stopping = False
    return app


async def _body(request: Request) -> bytes:
    """Return the body of a command; empty if it is too long or does not arrive."""
    body = b""
    try:
        async with asyncio.timeout(_COMMAND_SECONDS):
            async for piece in request.stream():
                body += piece
                if len(body) > _MAX_COMMAND_BYTES:
                    return b""
    except (TimeoutError, ClientDisconnect):
        return b""
    return body


def _refusal(request: Request, access: Access) -> Response | None:
    """Return the refusal of a request, or the entry page for a link with the token; None to proceed."""
    if not access.answers_to(request.headers.get("host")):
        return _plain(421, "this server does not answer to that name")
    given = request.query_params.get("token")
    if request.url.path == "/" and given is not None and access.is_token(given):
        response = Response(_ENTRY_PAGE, media_type="text/html")
        response.set_cookie(access.cookie, access.token, max_age=_YEAR, httponly=True, samesite="strict")
        return response
    has_token = access.is_token(request.cookies.get(access.cookie))
    if not has_token and (not access.loopback or request.method != "GET" or given is not None):
        return _plain(403, "open the link with the token that the server has printed")
    if request.method != "GET" and not access.same_origin(request.headers.get("origin"), request.headers.get("host")):
        return _plain(403, "only the page of this server may command")
    return None


def _plain(status: int, text: str) -> Response:
    return Response(text, status_code=status, media_type="text/plain")
