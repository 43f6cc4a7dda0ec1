"""The server of the page: the state as server-sent events, pictures, results, and the commands of the buttons."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from pydantic_core import to_json
from starlette.requests import ClientDisconnect
from starlette.staticfiles import StaticFiles

from tumble.bench.state import State
from tumble.bench.station import STEP_SECONDS, Station
from tumble.bench.web.access import HEADERS, Access
from tumble.programme.sheet_pictures import picture

PAGE = Path(__file__).parent / "page"
_KEEP_ALIVE = 1.0
_LOOK_SECONDS = 0.25 * STEP_SECONDS
_YEAR = 365 * 86400
_WAY_IN = '<meta http-equiv="refresh" content="0; url=/">'
"""Instead of a redirection: that of a link in another page would come back without the cookie."""
_LONGEST_COMMAND = 4096
_COMMAND_SECONDS = 10.0
"""How long the few bytes of a command may take to come."""
_COMMANDS_AT_ONCE = 2
"""Of one bench: one that takes minutes, and one that is told so."""
_WANTS = ("fault", "turn", "done")
"""Screens that want the operator, the most urgent first."""
_LISTED = ("unit", "session", "screen", "headline", "fault", "rest", "to_go", "result", "received")


def app_of(stations: Sequence[Station], access: Access) -> FastAPI:
    """The application that serves a station; several, each under its number from 1, and a list of them."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.state.stopping = False

    @app.middleware("http")
    async def guarded(request: Request, call: Callable[[Request], Awaitable[Response]]) -> Response:
        refused = _refusal(request, access)
        response = refused if refused is not None else await call(request)
        response.headers.update(HEADERS)
        return response

    @app.get("/favicon.ico")
    async def icon() -> Response:
        return Response(status_code=204)

    if len(stations) == 1:
        _serve_bench(app, "", stations[0], access, dict)
        return app
    _serve_page(app, "", "benches.html", APIRouter())

    @app.get("/events")
    async def events(request: Request) -> Response:
        return _stream(app, request, STEP_SECONDS, lambda: _event(listed(stations)))

    for number, station in enumerate(stations, 1):
        _serve_bench(app, f"/{number}", station, access, partial(_among, stations, number))
    return app


def listed(stations: Sequence[Station]) -> dict[str, Any]:
    """All benches by their numbers, from 1, each with the part of its state that the list shows, and the number of the
    one to go to `next`: one that wants the operator, else the one whose rest ends next."""
    states = [station.state for station in stations]

    def urgency(state: State) -> tuple[int, float]:
        if state["screen"] in _WANTS:
            return _WANTS.index(state["screen"]), 0.0
        seconds = (state.get("rest") or {}).get("left")
        return len(_WANTS), math.inf if seconds is None else seconds

    benches = [{"number": k, **{key: state.get(key) for key in _LISTED}} for k, state in enumerate(states, 1)]
    return {"benches": benches, "next": 1 + min(range(len(states)), key=lambda k: urgency(states[k]))}


def _among(stations: Sequence[Station], number: int) -> dict[str, Any]:
    return {"bench": number, **listed(stations)}


def _serve_page(app: FastAPI, prefix: str, index: str, routes: APIRouter) -> None:
    """Serve a page, its assets and its further routes."""

    @routes.get("/")
    async def page() -> Response:
        return FileResponse(PAGE / index, media_type="text/html; charset=utf-8")

    app.include_router(routes, prefix=prefix)
    app.mount(f"{prefix}/assets", StaticFiles(directory=PAGE))


def _serve_bench(
    app: FastAPI, prefix: str, station: Station, access: Access, others: Callable[[], Mapping[str, Any]]
) -> None:
    """Serve the page of a station; `others` goes with its state, which is written once for all pages that have got the
    same before."""
    routes = APIRouter()
    workers = ThreadPoolExecutor(_COMMANDS_AT_ONCE, thread_name_prefix="command")
    written: dict[tuple[int, bool], tuple[str, int]] = {}
    written_state: State = {}

    def event(state: State, since: int, may_command: bool) -> tuple[str, int]:
        """A state with the block means from number `since` on, and the number after the last."""
        nonlocal written, written_state
        if state is not written_state:
            written, written_state = {}, state
        if (since, may_command) not in written:
            trace = station.trace(since)
            whole = {**state, "trace": trace, "may_command": may_command, **others()}
            written[since, may_command] = _event(whole), trace["next"]
        return written[since, may_command]

    @routes.get("/events")
    async def events(request: Request) -> Response:
        may_command = access.knows(request.cookies.get(access.cookie))
        before: State = {}
        said, since = "", 0

        def now() -> str:
            nonlocal before, said, since
            state = station.state
            if state is not before:
                before = state
                said, since = event(state, since, may_command)
            return said

        return _stream(app, request, _LOOK_SECONDS, now)

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
        try:
            given = json.loads(await _body(request))
            name, value = str(given["do"]), str(given.get("value", ""))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return _plain(400, "expected a command")
        said = await asyncio.get_running_loop().run_in_executor(workers, station.command, name, value)
        return Response(to_json({"said": said}), media_type="application/json")

    _serve_page(app, prefix, "index.html", routes)


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


def _stream(app: FastAPI, request: Request, look_seconds: float, event: Callable[[], str]) -> Response:
    """Events as they change, looked at so often; where none has for a second, a word that the server is here."""

    async def events() -> AsyncIterator[str]:
        yield "retry: 500\n\n"
        before, said = "", 0.0
        while not app.state.stopping and not await request.is_disconnected():
            now = event()
            if now is not before and now != before:
                yield now
            elif time.monotonic() - said > _KEEP_ALIVE:
                yield "event: here\ndata: \n\n"
            else:
                await asyncio.sleep(look_seconds)
                continue
            before, said = now, time.monotonic()

    return StreamingResponse(events(), media_type="text/event-stream")


def _event(value: Mapping[str, Any]) -> str:
    """A value as an event; numbers that JSON has none for are null."""
    return f"data: {to_json(value, inf_nan_mode='null').decode()}\n\n"
