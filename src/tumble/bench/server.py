"""The server of the page: the state as server-sent events, pictures, results, and the commands of the buttons."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from starlette.requests import ClientDisconnect

from tumble.bench.access import HEADERS, Access
from tumble.bench.laboratory import listed
from tumble.bench.station import STEP_SECONDS, Station
from tumble.programme.sheet_pictures import picture

PAGE = Path(__file__).parent / "page"
ASSETS = {
    "bench.css": "text/css",
    "bench.js": "text/javascript",
    "benches.js": "text/javascript",
    "parts.js": "text/javascript",
    "vendor/uPlot.iife.min.js": "text/javascript",
    "vendor/uPlot.min.css": "text/css",
}
_KEEP_ALIVE = 1.0
_LOOK_SECONDS = 0.25 * STEP_SECONDS
_AGAIN, _STILL_HERE = "retry: 500\n\n", "event: here\ndata: \n\n"
_YEAR = 365 * 86400
_WAY_IN = '<meta http-equiv="refresh" content="0; url=/">'
"""Instead of a redirection: that of a link in another page would come back without the cookie."""
_LONGEST_COMMAND = 4096
_COMMAND_SECONDS = 10.0
"""How long the few bytes of a command may take to come."""
_COMMANDS_AT_ONCE = 2
"""Of one bench: one that takes minutes, and one that is told so."""


def app_of(stations: Sequence[Station], access: Access) -> FastAPI:
    """The application that serves a station; several, each under its number from 1, and a list of them."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.state.stopping = False

    @app.middleware("http")
    async def guarded(request: Request, call: Callable[[Request], Awaitable[Response]]) -> Response:
        refused = _refusal(request, access)
        response = refused if refused is not None else await call(request)
        for name, value in HEADERS.items():
            response.headers[name] = value
        return response

    @app.get("/favicon.ico")
    async def icon() -> Response:
        return Response(status_code=204)

    if len(stations) == 1:
        app.include_router(_page_of(app, stations[0], access, dict))
        return app
    app.include_router(_list_of(app, stations))
    for number, station in enumerate(stations, 1):
        routes = _page_of(app, station, access, partial(_others, stations, number))
        app.include_router(routes, prefix=f"/{number}")
    return app


def _others(stations: Sequence[Station], number: int) -> dict[str, Any]:
    """What the page of a bench shows of all."""
    return {"bench": number, **listed(stations)}


def _files(index: str) -> APIRouter:
    """A page and its assets."""
    routes = APIRouter()

    @routes.get("/")
    async def page() -> Response:
        return FileResponse(PAGE / index, media_type="text/html; charset=utf-8")

    @routes.get("/assets/{name:path}")
    async def asset(name: str) -> Response:
        if name not in ASSETS:
            return _plain(404, "no such file")
        return FileResponse(PAGE / name, media_type=ASSETS[name])

    return routes


def _list_of(app: FastAPI, stations: Sequence[Station]) -> APIRouter:
    """The list of the benches."""
    routes = _files("benches.html")

    @routes.get("/events")
    async def events(request: Request) -> Response:
        return StreamingResponse(_lists(app, stations, request), media_type="text/event-stream")

    return routes


def _page_of(app: FastAPI, station: Station, access: Access, others: Callable[[], dict[str, Any]]) -> APIRouter:
    """The page of a station; `others` goes with its state."""
    routes = _files("index.html")
    shown = _Shown(station, others)
    workers = ThreadPoolExecutor(_COMMANDS_AT_ONCE, thread_name_prefix="command")

    @routes.get("/events")
    async def events(request: Request) -> Response:
        may_command = access.knows(request.cookies.get(access.cookie))
        return StreamingResponse(_events(app, shown, request, may_command), media_type="text/event-stream")

    @routes.get("/picture/{number}.svg")
    async def drawing(number: int) -> Response:
        task = station.task
        if task.programme is None or not 0 <= number < len(task.programme.positions):
            return _plain(404, "no such position")
        return Response(picture(task.programme.positions[number], task.move(number)), media_type="image/svg+xml")

    @routes.get("/files/{name}")
    async def result(name: str) -> Response:
        path = station.file(name)
        if path is None or not path.is_file():
            return _plain(404, "no such result")
        return FileResponse(path, media_type="application/octet-stream", filename=name)

    @routes.post("/command")
    async def command(request: Request) -> Response:
        body = await _body(request)
        try:
            given = json.loads(body)
            name, value = str(given["do"]), str(given.get("value", ""))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return _plain(400, "expected a command")
        said = await asyncio.get_running_loop().run_in_executor(workers, station.command, name, value)
        return Response(json.dumps({"said": said}), media_type="application/json")

    return routes


async def _body(request: Request) -> bytes:
    """The body of a command; nothing of one that is too long, or does not come."""
    body = b""
    try:
        async with asyncio.timeout(_COMMAND_SECONDS):
            async for piece in request.stream():
                body += piece
                if len(body) > _LONGEST_COMMAND:
                    return b""
    except (TimeoutError, ClientDisconnect):
        return b""
    return body


def _refusal(request: Request, access: Access) -> Response | None:
    """Why a request is not answered; the way in with a token is answered here."""
    if not access.answers_to(request.headers.get("host")):
        return _plain(421, "this server does not answer to that name")
    given = request.query_params.get("token")
    if request.url.path == "/" and given is not None and access.knows(given):
        response = Response(_WAY_IN, media_type="text/html")
        response.set_cookie(access.cookie, access.token, max_age=_YEAR, httponly=True, samesite="strict")
        return response
    holds = access.knows(request.cookies.get(access.cookie))
    if not holds and (not access.loopback or request.method != "GET" or given is not None):
        return _plain(403, "open the link with the token that the server has printed")
    if request.method != "GET" and not access.same_origin(request.headers.get("origin"), request.headers.get("host")):
        return _plain(403, "only the page of this server may command")
    return None


def _plain(status: int, said: str) -> Response:
    return Response(said, status_code=status, media_type="text/plain")


class _Shown:
    """The states of a station as its pages get them, with what the page of a bench shows of the `others`: written once
    for all pages that have got the same."""

    def __init__(self, station: Station, others: Callable[[], dict[str, Any]]) -> None:
        self.station, self._others = station, others
        self._state: dict[str, Any] = {}
        self._written: dict[tuple[int, bool], tuple[str, int]] = {}

    def event(self, state: dict[str, Any], since: int, may_command: bool) -> tuple[str, int]:
        """A state with the block means from number `since` on, and the number after the last."""
        if state is not self._state:
            self._state, self._written = state, {}
        if (since, may_command) not in self._written:
            trace = self.station.trace(since)
            whole = state | {"trace": trace, "may_command": may_command} | self._others()
            self._written[since, may_command] = _event(whole), trace["next"]
        return self._written[since, may_command]


async def _events(app: FastAPI, shown: _Shown, request: Request, may_command: bool) -> AsyncIterator[str]:
    """The states as they change, each with the block means that are new since the one before."""
    yield _AGAIN
    before: dict[str, Any] = {}
    since, said = 0, 0.0
    while not app.state.stopping and not await request.is_disconnected():
        state = shown.station.state
        if state is not before:
            before = state
            event, since = shown.event(state, since, may_command)
            yield event
        elif time.monotonic() - said > _KEEP_ALIVE:
            yield _STILL_HERE
        else:
            await asyncio.sleep(_LOOK_SECONDS)
            continue
        said = time.monotonic()


async def _lists(app: FastAPI, stations: Sequence[Station], request: Request) -> AsyncIterator[str]:
    """The list of the benches as it changes."""
    yield _AGAIN
    before, said = "", 0.0
    while not app.state.stopping and not await request.is_disconnected():
        now = _event(listed(stations))
        if now != before:
            yield now
        elif time.monotonic() - said > _KEEP_ALIVE:
            yield _STILL_HERE
        else:
            await asyncio.sleep(STEP_SECONDS)
            continue
        before, said = now, time.monotonic()


def _event(value: dict[str, Any]) -> str:
    return f"data: {json.dumps(_finite(value))}\n\n"


def _finite(value: Any) -> Any:
    """The same without numbers that JSON has none for."""
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list | tuple) else value
