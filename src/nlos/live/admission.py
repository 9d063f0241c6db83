"""Who may see a page, and what the page may do: a token in the address, known host names, a strict content policy.

Requests with another Host are refused, so that no foreign page can ask through a browser's back (DNS rebinding); the
token is compared in constant time.
"""

import secrets
from collections.abc import Collection

from nlos.live.web import Answer, Refused, Request

_POLICY = (
    "default-src 'none'; {scripts}style-src 'nonce-{nonce}'; img-src data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
_SCRIPTS = "script-src 'nonce-{nonce}'; connect-src 'self'; "
_OURS = 'nonce="NONCE"'
"""Where a page's own styles and scripts name the word by which the browser knows them; text of others is escaped."""


def admitted(request: Request, token: bytes, hosts: Collection[str]) -> str:
    """What is asked for, below `/TOKEN/`. Raises `Refused` for anybody who has not the page's address. `hosts`: in
    small letters."""
    _, _, rest = request.path.partition("/")
    said, slash, what = rest.partition("/")
    if (
        request.host.lower() not in hosts
        or not secrets.compare_digest(said.encode("ascii", "replace"), token)
        or not slash
    ):
        raise Refused(403)
    return what


def page_answer(html: str, scripts: bool = True) -> Answer:
    """The page: it loads nothing from elsewhere, and runs no script but its own, or none at all."""
    nonce = secrets.token_urlsafe(16)
    policy = _POLICY.format(scripts=_SCRIPTS.format(nonce=nonce) if scripts else "", nonce=nonce)
    body = html.replace(_OURS, f'nonce="{nonce}"').encode()
    return Answer(body, kind="text/html; charset=utf-8", headers={"Content-Security-Policy": policy})
