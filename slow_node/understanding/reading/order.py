"""What comes first said first: "before you pass, slow down", "after you have slowed down, open the gap"."""

from __future__ import annotations

import re

from slow_node.understanding.reading.spans import lasting, spans_in_digits

_AND_THERE = re.compile(
    r",? (?:(?:and|und|et|y|e|en),? )?(?:when|once|as soon as|wenn|sobald|quand|une fois que?|cuando|una vez|quando|appena|als|zodra) "
    r"(?:(?:you.?re|you are|we.?re|we are|that.?s|that is|it.?s|you have|you.?ve) (?:there|done|finished|over there|through|done (?:that|it))|"
    r"(?:du|wir) (?:da|dort|druben|fertig) (?:bist|sind)|das (?:erledigt|geschafft|fertig) ist|tu y es|c.est fait|tu as fini|"
    r"(?:estes|estemos) (?:ahi|alli)|(?:hayas|hayamos) terminado|(?:ci sei|hai finito|e fatto)|(?:estiveres la|acabares|estiver feito)|"
    r"(?:je|we) (?:daar|klaar) (?:bent|zijn)|dat (?:klaar|gedaan) is),? "
    r"|,? (?:(?:and|und|et|y|e|en),? )?(?:(?:once|when) done|une fois (?:fait|la)|cela fait|una vez hecho|hecho esto|una volta fatto|fatto questo|"
    r"feito isso|uma vez feito)\b,? "
)
"""When the step before is done."""
_THEN_INSIDE = re.compile(
    r",? (?:and|und|et|y|e|en) (\w+(?: \w+)?) (?:then|danach|dann|anschliessend|puis|ensuite|luego|despues|poi|dopo|depois|daarna|dan) "
)
"""The verb before its "then"."""
_ACTS = (
    r"(?:\w+ing|move|slow|change|go|overtake|pass|speed|turn|drive|pull|brake|accelerate|merge|get|switch|"
    r"(?:du|wir) |d.|de |que |di |je |we )"
)
_BEFORE = re.compile(
    r"^(?P<last>.{6,}?),? (?:before|bevor|ehe|avant|antes|prima|voordat) (?:you |we |du |wir |je )?(?P<next>"
    + _ACTS
    + r".{3,})$"
)
_BUT_FIRST = re.compile(
    r"^(?P<last>.{4,}?)[,;]? (?:but|and|aber|mais|pero|ma|mas|maar) (?:before that|before you do(?: that)?|first|zuerst|vorher|davor|d'abord|avant ca|primero|antes de eso|"
    r"prima di questo|primeiro|antes disso|eerst|daarvoor),? (?P<next>.{4,})$"
)
_BUT_BEFORE = re.compile(
    r"^(?P<last>.{3,}?),? (?:but|and|aber|und|mais|et|pero|y|ma|e|mas|maar|en) (?P<next>.{4,}) (?:before that|beforehand|first|vorher|davor|zuerst|avant(?: ca| cela)?|d'abord|antes(?: de eso)?|primero|prima(?: di questo)?|antes disso|"
    r"primeiro|eerst|daarvoor)$"
)
_BEFORE_FIRST = re.compile(
    r"^(?:before|prior to|bevor|ehe|avant(?: de)?|antes(?: de)?|prima(?: di)?|voordat|alvorens) (?:you |we |du |wir |je )?(?P<next>"
    + _ACTS
    + r"[^,]{3,}), (?P<last>.{3,})$"
)
"""One thing before the other: said in either order."""
_LET_FIRST = re.compile(r"^lass(?:e|t)? (?:erst(?:mal)?|zuerst) ")
_OFF_BEFORE = re.compile(
    r"^(?P<holds>.*\b(?:do ?n.?t|not|never|no|nobody|stay|keep|remain|nicht|niemand\w*|bleib\w*|ne|pas|personne|reste\w*|nadie|non|nessuno|"
    r"nao|ninguem|niet|niemand)\b.*) (?:before (?:the|our|my) (?:next )?(?:exit|junction|turn-?off)|before we (?:come|get|turn) off|"
    r"vor (?:der|unserer) (?:nachsten )?(?:ausfahrt|abfahrt)|avant (?:la|notre) (?:prochaine )?sortie|antes de (?:la|nuestra) salida|"
    r"prima dell.uscita|antes da (?:nossa )?saida|voor (?:de|onze) (?:afslag|afrit))(?: (?:of |off )?(?:the |this )?(?:motorway|highway|freeway))?"
)
"""Not before the exit is: until then not."""
_BETWEEN = re.compile(
    r"\b(?:somewhere |irgendwo )?(?:between|zwischen|entre|tra|fra|tussen)(?: de)? ([2-9]\d|1\d\d)(?: ?km/h)? (?:and|und|et|y|e|en) ([2-9]\d|1\d\d)\b"
    r"(?! ?(?:m|s|met\w+|se[ck]\w*)\b)"
)

# What has been done by then, in the form in which it is asked for.
_DONE_EN = {
    "slow": "slowed|slowing", "move": "moved|moving", "change": "changed|changing", "overtake": "overtaken|overtook|overtaking", "pass": "passed|passing",
    "drop": "dropped|dropping", "go": "gone|going", "get": "got|gotten|getting", "pull": "pulled|pulling", "speed": "sped|speeding", "brake": "braked|braking",
    "switch": "switched|switching", "open": "opened|opening", "close": "closed|closing", "take": "taken|taking", "ease": "eased|easing",
    "merge": "merged|merging", "stop": "stopped|stopping", "accelerate": "accelerated|accelerating", "let": "letting",
}  # fmt: skip
_IMPERATIVE = {form: verb for verb, forms in _DONE_EN.items() for form in forms.split("|")}
_NEXT_EN = (
    r"(?:please |then )?(?:you can |you may )?(?:go|move|change|pull|slow|speed|drive|take|keep|overtake|pass|get|tuck|come|stop|drop|let|ease|brake|accelerate|hold|stay|close|leave|"
    r"merge|switch|open|do|put|back|fall|make)\b"
)
_HAVING = rf"(?:(?:after|once|when|as soon as) (?:you|we)(?:.ve|.re| have| are)? (?:finished |done )?|after )(?P<did>{'|'.join(_IMPERATIVE)})\b"
_AFTER_DOING = (
    re.compile(rf"^{_HAVING}(?P<last>[^,]*?),? (?P<next>{_NEXT_EN}.*)$"),
    re.compile(
        r"^(?:nachdem|sobald|wenn) (?:du|wir|sie) (?!.*\berreich)(?P<last>[^,]+?) (?:hast|bist|haben|sind|habt),? (?P<next>.+)$"
    ),
    re.compile(
        r"^(?:apres (?:avoir|etre|t.etre|que tu (?:as|aies))|(?:une fois|des|quand|lorsque) (?:que )?tu (?:as|auras|es|seras)|una vez que (?:hayas|has)|(?:cuando|en cuanto) (?:hayas|has)|"
        r"dopo (?:aver|esser\w*|che hai)|(?:una volta che|quando|appena) hai|depois que|(?:quando|assim que) tiveres) (?P<last>[^,]{4,}), (?P<next>.+)$"
    ),
    re.compile(
        r"^(?:despues de|tras|depois de|apos) (?P<last>(?!@|el|la|los|o|a)\w+[aei]r(?:se|te|lo|la)?\b[^,]*), (?P<next>.+)$"
    ),
    re.compile(
        r"^(?:nadat|zodra|als) (?:je|we|u) (?P<last>[^,]+?) (?:hebt|bent|heb|heeft|hebben|zijn),? (?P<next>.+)$"
    ),
)
_DONE_BEFORE = (
    re.compile(rf"^(?P<next>.{{4,}}?),? (?:but )?(?:only )?{_HAVING}(?P<last>.*)$"),
    re.compile(
        r"^(?P<next>.{4,}?),? (?:aber )?(?:erst,? )?nachdem (?:du|wir|sie) (?P<last>[^,]+?) (?:hast|bist|haben|sind|habt)$"
    ),
    re.compile(
        r"^(?P<next>.{4,}?),? (?:seulement |solo |soltanto )?(?:apres (?:avoir|t.etre)|dopo (?:aver|esser\w*)) (?P<last>.{4,})$"
    ),
    re.compile(
        r"^(?P<next>.{4,}?),? (?:solo |so )?(?:despues de|tras|depois de|apos) (?P<last>(?!@|el|la|los|o|a)\w+[aei]r(?:se|te|lo|la)?\b.*)$"
    ),
    re.compile(
        r"^(?P<next>.{4,}?),? (?:maar )?(?:pas )?nadat (?:je|we|u) (?P<last>[^,]+?) (?:hebt|bent|heb|heeft|hebben|zijn)$"
    ),
)
"""One thing once the other is done, said in either order."""
_KEEP_DOING = re.compile(
    r"\bkeep (?:on )?(?P<doing>braking|slowing|accelerating|speeding|moving|going(?= (?:faster|slower|left|right)))\b"
)
_US_AFTER = re.compile(
    r"^(?:first,? |zuerst |erst |d'abord |primero |prima |primeiro |eerst )?(?P<who><IT> ?(?:\w+ )?@\w+|@\w+)(?: (?:first|goes first|zuerst|d'abord|primero|prima|primeiro|eerst))?,? (?:and |und |et |y |e |en )?(?:then|dann|puis|ensuite|luego|despues|poi|dopo|depois|dan|daarna) "
    r"(?:us|we|wir|nous|nosotros|noi|nos|wij)\b(?: (?:go|move|can go|pueden?|gehen|andiamo|vamos|gaan))?,? ?(?P<next>.*)$".replace(
        "<IT>", r"(?:the|that|this|der|die|das|le|la|l'|el|il|o|a|de|het)"
    )
)
_ONLY_ONCE = re.compile(
    r"^(?:not|only) (?:before|until|till|once|when|after) (?P<when>[^,]+?),? (?:do|should|can|may|must) (?:you|we) (?P<next>.+)$"
)
_BACK = re.compile(
    r"(?<=\w),? (?:and|und|et|y|e|en) (?=(?:(?:tuck|slot|move|pull|slip|come|go|get|cut|merge|swing|return|head|drop|settle)\w*(?: us)? (?:back|in (?:again|behind))\b|return\b)"
    r"|(?:wieder |dann )?(?:zuruck|wieder (?:rein|rechts|links|nach))|(?:scher|ordne|geh|fahr|komm)\w* (?:dich )?wieder|(?:rabats|reviens|remets|retourne|replace)\w*|(?:te |tu te )rabat\w*|"
    r"(?:vuelve|regresa|retorna|reincorporate)\w*|(?:rientra|torna|ritorna|rimettiti|rientri)\b|(?:volta|regressa|retorna)\b|(?:(?:ga|kom|voeg|keer) )?(?:weer )?terug\b|(?:ga|rij) weer)"
)
"""To come back is for after what is done away."""
_ON_AGAIN = re.compile(
    r"(?:,? (?:and|und|et|y|e|en),? |, )(?P<on>off we go(?: again)?|on we go|carry on(?: as before)?|drive on|continue on|weiter(?: geht.?s| fahren)?|on repart|repars|continue|sigue|siga|seguimos|arranca|"
    r"riparti(?:amo)?|ripartire|prosegui|segue|siga|arranca|verder|rij (?:weer )?(?:verder|door))$"
)
"""What a row of wishes ends with."""
_WAITS_INSIDE = re.compile(
    r"(?<=\w), (?=(?:and |und |et |y |e |en )?(?:wait|hold on|hang on|hold back|warte?|attends|espera|aspetta|aguarda|wacht),? (?:until|till|for|bis|auf|que|qu|a que|che|tot|op)\b)"
)


_SIZES = re.compile(
    r"\b(?:somewhere |anywhere |irgendwo |quelque part )?(?:between|zwischen|entre|tra|fra|tussen)(?: de)? (?P<low>\d+(?:[.,]\d+)?|one|eine?r?|une?|una|uno|uma?|een) ?(?:s|m|met\w+|se[ckg]\w*)? ?(?:and|to|und|et|y|e|en) "
    r"(?P<high>\d+(?:[.,]\d+)?) (?P<unit>s|m|met\w+|se[ckg]\w*|(?:@?car )?lengths?|wagenlangen|longueurs)\b(?P<rest>.*)$"
)
"""Two bounds of a gap."""


def in_order(text: str) -> str:
    """A text in `searchable` form with spans in digits, and what comes first said first."""
    text = _LET_FIRST.sub("lass ", spans_in_digits(text)).replace("tu laisses ", "laisse ")
    text = _SIZES.sub(r"at least \g<low> \g<unit>\g<rest> and at most \g<high> \g<unit>\g<rest>", text)
    text = lasting(_BETWEEN.sub(r"at least \1 and at most \2", _OFF_BEFORE.sub(r"\g<holds> until the exit", text)))
    text = _KEEP_DOING.sub(lambda m: _IMPERATIVE[m["doing"]], text.replace("des qu'il", "des que il"))
    text = _THEN_INSIDE.sub(r", then \1 ", _AND_THERE.sub(", then ", text))
    text = _WAITS_INSIDE.sub(", then ", _BACK.sub(", then ", text))
    bare = _ONLY_ONCE.sub(r"once \g<when>, \g<next>", text.rstrip(".!? "))
    bare = _ON_AGAIN.sub(r", then \g<on>", bare)
    found = _US_AFTER.match(bare)
    if found is not None:
        return f"after {found['who']}, {found['next'] or 'drive on'}"
    for pattern in (_BUT_FIRST, _BUT_BEFORE, _BEFORE_FIRST, _BEFORE):
        found = pattern.match(bare)
        if found is not None:
            first, second = ("next", "last") if pattern in (_BUT_FIRST, _BUT_BEFORE) else ("last", "next")
            return f"{found[first]}, then {found[second]}"
    for pattern in (*_AFTER_DOING, *_DONE_BEFORE):
        found = pattern.match(bare)
        if found is not None and not (_GONE_BY.search(bare) or found["next"].startswith(("then ", "dann "))):
            did = found.groupdict().get("did")
            return f"{_IMPERATIVE.get(did, '') + ' ' if did else ''}{found['last'].strip()}, then {found['next']}"
    return bare if bare != text.rstrip(".!? ") else text


_GONE_BY = re.compile(
    r"\b(?:pass|overtake?|go|get|gone|got|uberhol|vorbei|doubl|depass|adelant|sorpass|super|ultrapass|inhaal|ingehaald|gepasseerd|voorbij)\w*\b.{0,20}@"
)
"""Who has been passed is waited for by name."""
