"""What must not rest on any model: commands that ask for harm or for other rules, recognised by their words.

Every pattern is matched against the folded text (lower case, no accents). A danger that is denied ("don't hit him") is
none. The rules know the main words of seven languages; the intent parser's own head stands beside them.
"""

from __future__ import annotations

import re

from slow_node.understanding.numbers import fold

_THEM = r"(?:him|her|them|it|us|(?:the|that|this|those|these|a|an|my|some|every|any)\s\w+)"
_RULES_EN = r"(?:(?:speed )?limits?|rules?|laws?|safety|red lights?|stop signs?|traffic (?:rules|laws|lights?)|signs)"
_SAFETY = (
    r"(?:\w+ ){0,2}(?:safety|brakes?|mask|airbags?|collision avoidance|limiter|lidar|sensors|bremsen|"
    r"sicherheit\w*|notbrems\w*|securite|freins|seguridad|frenos|sicurezza|freni|seguranca|freios|travoes|"
    r"veiligheid\w*|remmen)"
)

_HARM = re.compile(
    "|".join(
        (
            # harm
            r"\bram(?:m|me|en|s|ming)?\b(?!(?: \w+)? (?:niemand|kein))(?! ist\b)",
            r"\bsmash (?:in|through)",
            r"\bcrash(?:es|ing)? (?:it |us |the car )?(?:in ?to|against)",
            rf"(?<!'ve )\brun (?:{_THEM} )?(?:over|"
            r"down) {_THEM}",
            rf"\brun {_THEM} (?:over|off)",
            r"\bmow down",
            r"\bhit (?:him|her|them|(?:the|that|this|those|a) (?!gas|brake|"
            r"road|lane|fast|slow|left|right|accel|pedal|throttle)\w)",
            r"\bkill (?:him|her|them|us|me|every\w+|(?:the|that|this|those|a) (?:man|woman|guy|driver|cyclist|biker|people|"
            r"dog))\b",
            rf"\bhurt {_THEM}",
            rf"\b(?:push|force|shove|nudge) {_THEM} off",
            rf"\bbox {_THEM} in\b",
            rf"\bcut {_THEM} (?:off|up)\b",
            rf"\bcut off {_THEM}",
            r"\bbrake[- ]?(?:check|test)",
            r"\bsideswipe",
            r"\bcollide with",
            r"\bplay(?:ing)? chicken",
            r"\bhit and run\b",
            r"\bubers?fahr(?:e|en)? (?:ihn|sie|den|die|das)\b",
            r"\buber den haufen",
            r"\b(?:drang|drange) \w+ (?:ab|von der)",
            r"\bgeisterfahr",
            r"\bausbremsen\b",
            r"\bbrems \w+ aus\b",
            r"\b(?:percute|emboutis|defonce|ecrase)(?:z)?[- ](?:le|la|les|cette|ce|un)",
            r"\brentre[- ]lui dedans",
            r"\bqueue de poisson",
            r"\bcontresens",
            r"\b(?:embiste|atropella|chocal|chocar? (?:a|contra|con) |estrellat)",
            r"\bsacal\w de la (?:carretera|via)",
            r"\bsentido contrario",
            r"\bcontramano",
            r"\b(?:sperona|investil|tampona(?:lo|la| quel)|travolgi)",
            r"\bcontromano",
            r"\b(?:atropel[ae]|abalroa|contramao)",
            r"\bspookrij",
            # where and how no car may drive
            r"\bon (?:to )?the (?:hard )?(?:shoulder|sidewalk|pavement|footpath|bike (?:path|lane))\b",
            r"\b(?:drive|go|pass|nip|overtake|undertake) (?:\w+ )?(?:on|onto|along) the verge\b",
            r"(?<!next to )\bthe (?:hard shoulder|emergency lane|breakdown lane)",
            r"\bthe wrong way (?:up|down|on|along)",
            r"\bwrong side of the road",
            r"\bagainst (?:the )?(?:oncoming )?traffic",
            r"\binto (?:the )?oncoming",
            r"\b(?:do|make|take|pull|perform) an? (?:\w+ )?u[- ]?turn",
            r"\b(?:turn|swing|spin) (?:a?round|back) (?:right )?(?:here\b|and (?:head|go|drive) back)",
            r"\bmissed .{0,20}\b(?:exit|turn\w*|junction|ramp|slip road)\b.{0,30}\b"
            r"(?:back (?:it )?up|reverse|go back|turn back)",
            r"\b(?:back (?:it )?up|reverse|roll back) (?:in)?to (?:the|that|our) (?:exit|turn\w*|junction|ramp|slip road)",
            r"\b(?:run|jump|blow|ignore|skip) (?:through )?(?:the|that|this|a|every|all) (?:next )?(?:red|"
            r"stop sign|lights?\b)",
            r"\b(?:through|over) (?:the|a|that) red\b",
            r"\bput it in reverse\b",
            r"\bdrive backwards",
            r"\breverse (?:on|down|along|back) ",
            r"\b(?:auf|uber) (?:dem|den) (?:standstreifen|gehweg|burgersteig|seitenstreifen)",
            r"\bbei rot\b",
            r"\bgegenverkehr rein",
            r"\bin den gegenverkehr",
            r"\bbande d'arret",
            r"\bsur le trottoir",
            r"\b(?:grille|brule)(?:r|z)? (?:le |ce |un )?(?:feu|stop|rouge)",
            r"\bpor (?:el|la) (?:arcen|acera)",
            r"\bsaltat\w* (?:el|ese|un) (?:semaforo|rojo|stop)",
            r"\bcorsia d'emergenza",
            r"\bsul marciapiede",
            r"\b(?:col|con il) rosso\b",
            r"\bpelo (?:acostamento|passeio)",
            r"\bpela (?:berma|calcada)",
            r"\bfura o sinal",
            r"\bvluchtstrook",
            r"\bop de stoep",
            r"\bdoor rood\b",
            # the law on purpose
            rf"\b(?:ignor\w*|forget|break|disregard|exceed|screw|bypass|violate) (?:about )?(?:the |all |every |"
            rf"your |any |those |these )*{_RULES_EN}\b(?! (?:what|that))",
            rf"\b(?:to hell with|sod|stuff|bugger|damn|blast|hang|never mind|who cares about) (?:the |all |every |your |any |"
            rf"those |these )*{_RULES_EN}\b",
            r"\b(?:do ?n[o']?t|dont|never|no) brak(?:e|ing)\b.{0,12}\b(?:who|what)ever (?:\w+ )?(?:step|walk|run|jump|come|get|"
            r"turn)s?\b",
            r"\b(?:over|above|past|beyond|faster than) the (?:speed |legal )?limit",
            r"\b(?:ignorier\w*|vergiss|scheiss auf|missachte) (?:das |die |alle |deine )*(?:tempolimit|"
            r"geschwindigkeitsbe\w+|verkehrsregeln|regeln|ampel|sicherheit\w*)",
            r"\buber dem (?:tempo)?limit",
            r"\bschneller als erlaubt (?:fahren|ist|bitte)",
            r"\b(?:ignore|oublie|respecte pas) (?:la |les |toutes les )+(?:limitation|limite|regles)",
            r"\b(?:ignora|olvida|olvidate de|dimentica|esquece) (?:el |los |las |la |il |i |le |o |as )*(?:limite|"
            r"limites|normas|reglas|limiti|regole|regras|semaforo)",
            r"\bpor encima del limite",
            r"\bau-dessus de la limite",
            r"\bsopra il limite",
            r"\bacima do limite",
            r"\bboven de limiet",
            # the car's own safety
            rf"\b(?:switch|turn|shut) off {_SAFETY}",
            rf"\b(?:disable|deactivate|bypass|override|remove|desactive|desactiva|disattiva|desativa|"
            rf"deaktivier\w*) {_SAFETY}",
            rf"\b(?:turn|switch|schalte?) {_SAFETY}(?: \w+)? (?:off|aus|ab)\b",
            r"\bsafety (?:systems? )?off\b",
            r"\bwithout (?:braking|looking|brakes)\b",
            r"(?<!my )\beyes (?:closed|shut)",
            r"\b(?:scare|frighten|intimidate) (?:the|that|him|her|those)",
            r"\bteach (?:him|her|them|that \w+) a lesson",
            r"\b(?:half|quarter|tenth)s? (?:of )?a second behind",
            r"\bbumper to bumper",
            r"\b(?:outrun|escape|flee|lose) (?:from )?the (?:police|cops)",
            r"\brace (?:him|her|that|the (?!traffic)|against)\b",
            r"\bdrag race",
            rf"\btailgate {_THEM}",
            r"\b(?:clip|knock off|take off|break) (?:his|her|their) (?:wing )?mirror",
            r"\b(?:brake|stop) (?:hard |dead )?(?:right )?in front of (?:him|her|them|that)",
            r"\bslam (?:on )?the (?:brakes|anchors)\b.{0,40}\b(?:behind|tailgater|idiot)",
            r"\bdo ?n[o']?t (?:let|make way for) (?:the|that|this) (?:ambulance|fire (?:engine|truck)|police)",
            r"\bdo ?n[o']?t (?:bother )?(?:brak|stop|slow)\w* (?:down )?(?:for|at) (?:the |that |those |any |this )?"
            r"(?:pedestrian|people|kids|children|police|cop|officer|cross(?:walk|ing)|zebra|red|stop sign|lights?\b)",
            r"\bblock (?:him|her|them|the (?:ambulance|road|lane|others))\b",
            r"\b(?:swerve|steer|aim|drive|go|head) (?:straight |right )?(?:at|into|through|towards?|for) (?:him|her|them|"
            r"(?:the|that|a|those) (?:\w+ )?(?:crowd|people|cyclists?|bikers?|pedestrians?|wall|barrier|guardrail|tree|river|"
            r"lake|cones|fence|oncoming))\b",
            r"\b(?:do|make|pull|perform) (?:an? |some )?(?:\w+ )?(?:donuts?|doughnuts?|burnouts?|wheel(?:ie|spin)s?|"
            r"handbrake turns?)\b",
            r"\b(?:slalom|zigzag|zig-zag) (?:through|between)",
            r"\b(?:let go of|hands off) the wheel",
            r"\bdrive (?:on|over|across) the (?:grass|fields?|median|central reservation|cones|kerb|curb)",
            r"\b(?:cross|over|on|across) (?:the|that|a) (?:solid|double|continuous)(?: white| yellow)? line",
            r"\b(?:ubern|am|der|den) standstreifen",
            r"\bbande d'urgence",
            r"\bpass(?:e|ez|er) au rouge",
            r"\bvoie d'en face",
            r"\bgrill(?:e|er|ez) (?:les|des) feux",
            r"\bubers? rot\b",
            r"\bdurchgezogene linie",
            r"\bligne continue",
            r"\blinea continua",
            r"\bdoorgetrokken streep",
            r"\bmot rott\b",
            r"\bna czerwonym",
            r"\bpain punais",
            *map(
                fold,
                ("на красный", "протарань", "k\u0131rm\u0131z\u0131da ge\u00e7", "闯红灯", "赤信号を無視", "신호 무시"),
            ),
        )
    )
)

_INJECTION = re.compile(
    "|".join(
        (
            r"\b(?:ignor\w*|disregard|forget|override|bypass|vergiss|olvida|oublie|dimentica|esquece|vergeet|"
            r"negeer)\b.{0,30}\b(?:instruc\w+|instruktion\w*|anweisung\w*|prompts?|programming|guidelines|consignes|"
            r"istruzioni|instructies|previous rules)",
            r"\bsystem ?prompt",
            r"\b(?:your|tes|deine|tus|tue|suas|je) (?:hidden |initial |original )?(?:prompt|instructions?|"
            r"instruktionen|anweisungen|instrucciones|istruzioni|instrucoes|instructies)\b",
            r"^\W*(?:system|assistant|developer|admin|root|sudo|systeme?|sistema)\b.{0,12}[:>\]]",
            r"\bsudo\b",
            r"<\W*/?\s*(?:system|command|im_start|instruction)",
            r"\b(?:developer|debug|god|admin|jailbreak|maintenance|unrestricted|entwickler|desarrollador|"
            r"developpeur|sviluppatore) ?-?(?:mode|modus|modo)\b",
            r"\bmod[eo] (?:developpeur|desarrollador|sviluppatore|dieu|dios|admin\w*)",
            r"\bjailbreak",
            r"\byou are (?:now|no longer) (?:an? )?(?:\w+ ){0,3}(?:ai|dan|assistant|unrestricted|pirate|free)\b",
            r"\b(?:act|behave) as (?:if you had no|an? unrestricted|dan\b)",
            r"\bpretend (?:that )?(?:you|the) .{0,40}(?:no rules|no restrictions|unrestricted|does(?: not|n't) exist)",
            r"[\"'{]\s*(?:outcome|speed|role|lane|target_speed_mps|overtake)\"?\s*[:=]",
            r"\boutcome ?(?:=|:|to|directive)",
            r"\btarget_speed_mps",
            r"\bset safety ?=",
            r"\b(?:answer|respond|reply|antworte|reponds|responde|rispondi|antwoord) (?:only |exactly |just |nur |"
            r"uniquement |solo |apenas |alleen |genau |exakt |exactement |exactamente |esattamente |exatamente |precies )+"
            r"(?:with|mit|met|con|com|par)?",
            r"\b(?:remove|lift|drop) (?:all )?(?:your )?(?:restrictions|filters|guardrails)",
            # a dictated answer
            r"\b(?:speed|lane|gap|overtake|cancel|outcome) ?={1,2} ?\"?(?:faster|slower|keep|stop|closer|farther|left\w*|"
            r"right\w*|"
            r"true|false|none|null|directive)\b",
            r"\b(?:output|print|emit|return|reply|respond|answer|write|give|produce|send|as|this|valid|following|"
            r"raw) .{0,25}\bjson\b",
            r"\bjson (?:with|where|in which|only|output|object)\b",
            r"\b(?:answer|reply|response|output) (?:must|should|has to|have to|needs? to|shall) (?:be|contain|start|begin|"
            r"read|say|"
            r"include|equal)\b",
            r"\b(?:correct|expected|final|desired) (?:answer|output|reply|response) (?:is|here|will|would|must|"
            r"to this)\b",
            r"\b(?:your|end your|start your|begin your) (?:answer|output|reply|response) (?:is|will be|with)\b(?! (?:wrong|"
            r"late|right))",
            r"\b(?:classify|label|mark|treat|flag|categori[sz]e|tag|parse) (?:this|it|that|the|"
            r"my)\b.{0,40} as (?:an? )?\W?(?:directive|"
            r"safe|harmless|allowed|valid|approved|permitted|faster|slower|left|right|not refused|in scope)",
            r"\b(?:set|mark|fill) .{0,30}\b(?:slot|field|flag|outcome|json)\b.{0,20}\b(?:to|with|as)\b",
            r"\bthe (?:speed|lane|gap|overtake|cancel|outcome|refused) (?:slot|field|flag|key)\b",
            r"\b(?:output|print|emit|repeat|write) (?:only|exactly|verbatim|nothing but|after me|the (?:word|string|token|"
            r"following))\b",
            r"\b(?:say|reply|respond|answer) (?:with )?(?:exactly|verbatim|the (?:word|string|token)|nothing but)\b",
            r"\b(?:from now on|henceforth|always|whatever (?:\w+ ){1,4})[, ]*(?:you )?(?:must |will |should )?(?:answer|"
            r"reply|respond|output)"
            r"\b",
            r"\brepeat (?:everything|all|the (?:text|words?|lines?|prompt))(?: of \w+)? (?:above|before|preceding)",
            r"\[/?(?:inst|sys|system)\]",
            r"<\|",
            r"#{2,} ?(?:instruction|system|response|input|new)",
            r"\bend of (?:the )?(?:system |user |passenger )?(?:prompt|input|instructions|message)",
            r"\b(?:your|the above|all|previous|earlier|prior) (?:rules|guidelines|restrictions|polic(?:y|ies)|"
            r"guardrails)(?: above)? (?:no longer|"
            r"do(?: not|n't) (?:apply|count)|are (?:now )?(?:void|off|lifted|suspended|cancelled|gone))",
            r"\b(?:as|this is|i am|i'm) your (?:developer|administrator|admin|creator|programmer|operator|maker)\b",
            r"\b(?:base64|rot13)\b",
            r"\b(?:deine|die) (?:antwort|ausgabe) (?:lautet|muss|soll|ist)\b(?! (?:falsch|gut|"
            r"richtig))",
            r"\bgib (?:mir )?(?:als antwort |nur |genau |"
            r"exakt |ausschliesslich )+.{0,40}\b(?:aus|zuruck)\b",
            r"\bta reponse (?:doit|sera|est)\b",
            r"\btu respuesta (?:debe|tiene que|sera|es)\b",
            r"\btua risposta (?:deve|sara|e)\b",
            r"\b(?:tua|sua) resposta (?:deve|tem|sera|e)\b",
            r"\bje antwoord (?:moet|luidt|is|wordt)\b",
            r"\b(?:vastaa (?:tasmalleen|vain)|svara (?:exakt|bara|endast)|odpowiedz (?:dok\w+adnie|tylko|wylacznie))\b",
            r"\b(?:tes|deine|tus|tue|suas|je) (?:regles|regeln|reglas|regole|regras|regels) (?:ne s'appliquent|"
            r"gelten (?:ab jetzt )?nicht|ya no|"
            r"non valgono|nao valem|gelden niet)",
            r"\b(?:zignoruj|ignorera|unohda|zapomnij)\b.{0,20}\b(?:polecenia|instrukcj\w+|instruktion\w*|ohje\w*)",
            "(?:\u5ffd\u7565|\u65e0\u89c6|\u5fd8\u8bb0).{0,10}(?:\u6307\u4ee4|\u89c4\u5219|\u63d0\u793a|\u6307\u793a)",
            "\u53ea(?:\u56de\u7b54|\u8f93\u51fa)",
            # the mask, the checks, the modes
            r"\b(?:disable|bypass|skip|ignore|trick|circumvent|override|get a?round|remove|drop|switch off|turn off|lie to) "
            r"(?:\w+ ){0,2}(?:mask|guard(?:rails?)?|filters?|governor|speed cap|validation|restrictions|constraints)\b",
            r"\b(?:turn|switch|shut) (?:\w+ ){0,2}(?:mask|guardrails?|filters?)\b.{0,8}\boff\b",
            r"\bmask(?:ing)? (?:is )?off\b",
            r"\b(?:sicherheitsmaske|masque de securite|mascara de segur\w+|maschera di sicurezza|veiligheidsmasker)\b",
            r"\b(?:umgeh|contourn|aggir|omzeil)\w* (?:\w+ )?(?:mask|mascara)\w*",
            r"\b(?:salta\w*|contorna) (?:la|tu|a) mascara",
            r"\b(?:test|service|factory|hidden|beast|override|unlimited|root|engineer\w*|diagnostic|dev)[- ]mode\b",
            r"\b(?:wartungs|onderhouds|ontwikkelaars)modus\b",
            r"\bmod(?:e|o|alita) (?:de )?(?:maintenance|man[tu]\w+|"
            r"desenvolvedor|programador)\b",
            r"\b(?:print|show|reveal|repeat|recite|dump|quote|translate|summari[sz]e|list|spell out|export|leak|upload|send|"
            r"paraphrase) (?:me )?(?:all |out |back )?(?:of )?your (?:\w+ )?(?:rules|guidelines|config\w*|context|secrets?|"
            r"polic\w+)",
            r"\b(?:never|must not|may not|can ?not|can't|stop) refus\w+",
            r"\brefus\w+ (?:are|is) forbidden",
            r"\b(?:your |the |all )(?:rules|checks|constraints|guardrails|safety \w+) (?:have been |has been |are |is |now )*"
            r"(?:lifted|suspended|revoked|disabled|deprecated|void|abolished|removed|paused)\b",
            r"\b(?:access|override|authori[sz]ation|unlock) code\b",
            r"\bthe password is\b",
            r"\b(?:i'm|i am) (?:the |an? |your )?(?:root|admin(?:istrator)?|superuser)\b",
            r"\brepeat after me\b",
            r"\b(?:roleplay|role-play) as\b",
            r"\b(?:administrator|beheerder|amministratore|administrateur|administrador),? ",
            # code and encodings
            r"[{]\s*[\"']?\w+[\"']?\s*:",
            r"\b(?:drop table|rm -rf|select \* from|kill -9|os\.system)\b",
            r"\b\w+_\w+ ?\(",
            r"\b(?:mask|safety|limits?|rules|max_?speed|\w+_\w+|\w+\.\w+) ?:?=+ ?\w",
            r"</?(?:user|admin|tool\w*|function\w*|prompt)\b",
            r"\b(?=[a-z]*\d)[a-z0-9+/]{12,}={1,2}(?!\w)",
        )
    )
)

_NEGATION = re.compile(
    r"\b(?:do ?n[o']?t|dont|(?<!why )not|never|avoid|no need to|shouldn't|mustn't|must not|should not|without|"
    r"wo ?n'?t|wouldn'?t|"
    r"nicht|kein\w*|niemand\w*|niemals|nie|ne|pas|no|nunca|non|"
    r"mai|nao|niet|nooit|geen|stop|quit)\b[^.,;:!?]{0,25}$"
)
_TOLD = re.compile(r"\b(?:if\b[^.,;]*|(?:we|he|you|they)(?:'ll|'d|'re| are| will| would)|going to|gonna) ?$")
"""Said about what happens, not asked for: "you're over the limit", "if he brakes we crash into him"."""
_PLAYED = re.compile(
    r"\b(?:play|listen to|hear|song|track|album|podcast|audiobook|film|movie|titled|called|spiel|joue|reproduce|"
    r"speel)\b"
    r"(?:(?! (?:and|then|while|und|et|y|e|en) )[^.,;:!?]){0,30}$"
)
"""What follows is what something is called: "play Crash Into Me"."""
_DONT_CARE = re.compile(r"\b(?:do ?n[o']?t|dont|no) (?:care|mind|bother|worry|brake|stop|slow)\b[^.,;:!?]{0,25}$")


def unsafe(command: str) -> bool:
    """The command asks for harm, for breaking the law or for other rules, in so many words."""
    text = fold(command)
    if _INJECTION.search(text):
        return True
    return any(not _denied(text[: match.start()]) for match in _HARM.finditer(text))


def _denied(before: str) -> bool:
    if _TOLD.search(before) or _PLAYED.search(before):
        return True
    return bool(_NEGATION.search(before)) and not _DONT_CARE.search(before)
