"""Web page of the live view: three static files and the views as server-sent events."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from importlib import resources

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from charact.live.live_loop import LiveLoop

LOOK_S = 0.005
FILES = {
    "/": ("live.html", "text/html"),
    "/live.js": ("live.js", "text/javascript"),
    "/live.css": ("live.css", "text/css"),
}


def page(
    running: LiveLoop,
    *,
    title: str,
    focus_first: bool = False,
    is_closing: Callable[[], bool] = lambda: False,
) -> Starlette:
    """Return the application; put it behind a `charact.live.server.PageAccess`.

    `focus_first`: whether the focus is the main value; `is_closing`: whether the server ends, and
    with it the event streams. No route accesses an instrument; the only action is to forget the
    best focus.
    """
    page_data = {"title": title, "source": running.source.name, "focus_first": focus_first}

    async def events(request: Request) -> Response:
        stream = _events(running, page_data, is_closing)
        return StreamingResponse(stream, media_type="text/event-stream")

    async def view(request: Request) -> Response:
        newest = running.newest.view
        if newest is None:
            return JSONResponse(
                {"waiting": running.newest.end_reason or "no frame yet"}, status_code=503
            )
        return JSONResponse({**page_data, **newest.as_json()})

    async def picture(request: Request) -> Response:
        newest = running.newest.view
        if newest is None:
            return PlainTextResponse("no frame yet", status_code=503)
        return Response(newest.preview.jpeg, media_type="image/jpeg")

    async def forget(request: Request) -> Response:
        running.forget_best()
        return PlainTextResponse("forgotten")

    files = [Route(path, _file(*named)) for path, named in FILES.items()]
    return Starlette(
        routes=[
            *files,
            Route("/events", events),
            Route("/view.json", view),
            Route("/picture.jpg", picture),
            Route("/best/forget", forget, methods=["POST"]),
        ]
    )


def _file(name: str, media_type: str):
    text = (resources.files("charact.live") / "pages" / name).read_text()

    async def endpoint(request: Request) -> Response:
        return Response(text, media_type=media_type)

    return endpoint


async def _events(
    running: LiveLoop, page_data: dict, is_closing: Callable[[], bool]
) -> AsyncIterator[str]:
    """Yield the title, then each newer view; a slow reader skips views."""
    yield _event("about", page_data)
    sent, silent_s = 0, 0.0
    while not is_closing():
        view = running.newest.view
        if view is not None and view.number > sent:
            sent, silent_s = view.number, 0.0
            yield _event("view", view.as_json())
        elif (why := running.newest.end_reason) is not None:
            yield _event("ended", {"why": why})
            return
        else:
            await asyncio.sleep(LOOK_S)
            silent_s += LOOK_S
            if silent_s >= 1.0:
                silent_s = 0.0
                yield ": no frame yet\n\n"


def _event(kind: str, data: dict) -> str:
    return f"event: {kind}\ndata: {json.dumps(data, allow_nan=False)}\n\n"
