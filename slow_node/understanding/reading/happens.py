"""Times that are told, and not waited for: "my train leaves in ten minutes", "we have been here for ten minutes"."""

from __future__ import annotations

import re

_TIME = r"(?P<time>\d+(?:[.,]\d+)? ?(?:min\w*|se[ck]\w*|seg\w*|hours?|stunden?|heures?|horas?|ore|uur)\b)"
_SOON = (
    r"(?:in|dans|en|dentro de|tra|fra|daqui a|em|over)(?: about| etwa| environ| unos| circa| cerca de| ongeveer)? "
    + _TIME
)
_WHOSE = (
    r"(?:my|our|the|his|her|your|this|mein\w*|unser\w*|der|die|das|mon|ma|mes|notre|le|la|les|mi|mis|nuestr[oa]|el|los|il|lo|"
    r"mio|mia|o|a|os|as|meu|minha|nosso|nossa|mijn|onze?|de|het)"
)
_HAPPENS = (
    r"(?:starts|begins|boards|closes|shuts|leaves|departs|goes|ends|opens|lands|kicks off|takes off|is due|are due|is|arrives|"
    r"beginnt|fangt|schliesst|macht|geht|fahrt|startet|legt|landet|ist|kommt|"
    r"decolle|commence|ferme|ouvre|part|atterrit|est|debute|arrive|empieza|comienza|sale|cierra|despega|abre|llega|"
    r"chiude|parte|comincia|inizia|decolla|apre|arriva|sai|comeca|fecha|descola|chega|begint|vertrekt|sluit|gaat|opent)"
)
_TOLD = tuple(
    re.compile(pattern)
    for pattern in (
        rf"\b{_WHOSE} (?:[\w@'-]+ ){{1,4}}?{_HAPPENS} {_SOON}",
        rf"\b[\w-]+(?:'s| is| ist| est) {_SOON}",
        rf"\b(?:arrivo|arrive|llego|chego|be there|be home|be at \w+|home) {_SOON}",
        rf"^{_SOON} (?:{_HAPPENS}|we have to|i have to|i must|muss ich|mussen wir|soll ich|moet ik) ",
        r"\b(?:been|'ve|stuck|stood|sat|waited|seit|depuis|llevamos|llevo|siamo)\b[^,.;]*?"
        r"(?P<lasting> ?(?:for|since|seit|depuis|da|desde hace)? (?P<time>\d+(?:[.,]\d+)? ?(?:min\w*|hours?|stunden?|heures?|horas?|ore|uur)\b))",
    )
)


def told(text: str) -> str:
    """A text in `searchable` form without the times in it that only tell what happens or how long it has lasted."""
    for pattern in _TOLD:
        found = pattern.search(text)
        if found is not None:
            lasts = "lasting" in pattern.groupindex
            start, end = found.span("lasting" if lasts else "time")
            text = f"{text[:start]}{'' if lasts else 'soon'}{text[end:]}"
    return text
