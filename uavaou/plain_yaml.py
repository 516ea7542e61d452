"""Plain YAML: mappings, lists, text, numbers, true, false and null. The one reader, of every file and of ``--set``.

It refuses what reads otherwise than it looks (octal numbers, numbers in base 60, a key given twice, merge keys), and
what only a program writes (tags, aliases). Its work is in proportion to the text.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from uavaou.errors import InputError

_MOST_VALUES = 1_000_000  # a scenario of 100,000 devices has 700,000
_DEEPEST = 100  # lists and mappings inside each other
_LONGEST_NUMBER = 400  # characters; the longest that fits a float has 309 digits
_LONGEST_QUOTED = 40
_PARSER: Any = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader  # libyaml takes a fifth of the time

_WORDS = {"": None, "~": None} | {
    form: value
    for value, words in ((None, ["null"]), (True, ["true", "yes", "on"]), (False, ["false", "no", "off"]))
    for word in words
    for form in (word, word.capitalize(), word.upper())
}
_WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9_]*)\Z")
_OTHER_BASE = re.compile(r"[-+]?0(?:b[01][01_]*|x[0-9a-fA-F][0-9a-fA-F_]*)\Z")
_FLOAT = re.compile(
    r"[-+]?(?:(?:[0-9][0-9_]*\.[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?|[0-9][0-9_]*[eE][-+]?[0-9]+"
    r"|\.(?:inf|Inf|INF|nan|NaN|NAN))\Z"
)
_OCTAL = re.compile(r"[-+]?0[0-7_]+\Z")
_BASE_60 = re.compile(r"[-+]?(?:[1-9][0-9_]*(?::[0-5]?[0-9])+|[0-9][0-9_]*(?::[0-5]?[0-9])+\.[0-9_]*)\Z")


def parse_yaml(text: str, source: str) -> Any:
    """Return what a YAML text says, as plain Python values.

    Args:
        text: one document.
        source: of the text, for error messages.

    Raises:
        InputError: the text is no YAML, or YAML that is not plain; it names the line of a text of several lines.
    """
    try:
        return _Reader(text, source).document()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f" at line {mark.line + 1}"
        raise InputError(f"{source}: not valid YAML{where}: {error.problem or error.context}") from None
    except (yaml.YAMLError, UnicodeError) as error:  # characters that YAML does not allow
        raise InputError(f"{source}: not valid YAML: {getattr(error, 'reason', error)}") from None


class _Reader:
    """Builds values from libyaml's events."""

    def __init__(self, text: str, source: str) -> None:
        self._source, self._one_line = source, "\n" not in text.strip()
        self._events: Iterator[Any] = yaml.parse(text, Loader=_PARSER)
        self._values = 0

    def document(self) -> Any:
        found = [self._value(event) for event in self._events if isinstance(event, yaml.NodeEvent)]
        if len(found) > 1:
            raise InputError(f"{self._source}: not valid YAML: {len(found)} documents, expected one")
        return found[0] if found else None

    def _value(self, event: Any, depth: int = 0) -> Any:
        self._values += 1
        if self._values > _MOST_VALUES:
            raise self._refusal(event, f"more than {_MOST_VALUES:,} values")
        if isinstance(event, yaml.AliasEvent):
            raise self._refusal(event, "aliases are not read: write the value out")
        if event.tag is not None:
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            raise self._refusal(event, f"the tag {tag:.60} is not read: write the value alone")
        if isinstance(event, yaml.ScalarEvent):
            return self._plain(event) if event.implicit[0] else event.value
        if depth == _DEEPEST:
            raise self._refusal(event, f"more than {_DEEPEST} lists and mappings inside each other")
        if isinstance(event, yaml.SequenceStartEvent):
            return [self._value(each, depth + 1) for each in self._until(yaml.SequenceEndEvent)]
        return self._mapping(depth)

    def _until(self, end: type[Any]) -> Iterator[Any]:
        while not isinstance(event := next(self._events), end):
            yield event

    def _mapping(self, depth: int) -> dict[Any, Any]:
        found: dict[Any, Any] = {}
        lines: dict[Any, int] = {}
        for event in self._until(yaml.MappingEndEvent):
            if not isinstance(event, yaml.ScalarEvent | yaml.AliasEvent):
                raise self._refusal(event, "a list or mapping cannot be a key")
            key, line = self._value(event, depth + 1), _line(event)
            if key in found:
                lines_given = "" if self._one_line else f" (lines {lines[key]} and {line})"
                raise InputError(f"{self._source}: the key {str(key)[:60]!r} is given twice{lines_given}")
            found[key], lines[key] = self._value(next(self._events), depth + 1), line
        return found

    def _plain(self, event: Any) -> Any:
        """The value of an unquoted scalar."""
        text = event.value
        if text in _WORDS:
            return _WORDS[text]
        if text[0] not in "+-.0123456789":
            if text == "<<":
                raise self._refusal(event, "merge keys (<<) are not read: write the fields themselves")
            return text
        whole, based, real = _WHOLE.match(text), _OTHER_BASE.match(text), _FLOAT.match(text)
        if not (whole or based or real or _OCTAL.match(text) or _BASE_60.match(text)):
            return text
        if len(text) > _LONGEST_NUMBER:
            raise self._refusal(event, f"a number of {len(text):,} characters")
        digits = text.replace("_", "")
        if whole or based:
            return int(digits, 10 if whole else 0)
        if real:
            return float(digits.replace(".", "") if digits[-1] in "fFnN" else digits)  # .inf, .nan
        raise self._refusal(event, _misread(text, digits))

    def _refusal(self, event: Any, problem: str) -> InputError:
        where = "" if self._one_line else f"line {_line(event)}: "
        return InputError(f"{self._source}: {where}{problem}")


def _line(event: Any) -> int:
    line: int = event.start_mark.line
    return line + 1


def _misread(text: str, digits: str) -> str:
    """Why a number that looks decimal is refused, and what to write."""
    if len(text) > _LONGEST_QUOTED:
        return f"{text[:_LONGEST_QUOTED]}...: YAML reads this number in base 8 or 60: write it as a decimal"
    if ":" not in text:
        return f"{text}: YAML reads this as octal, {int(digits, 8)}: write {int(digits)} or {int(digits, 8)}"
    value: float = 0
    for part in digits.lstrip("+-").split(":"):
        value = value * 60 + (float(part) if "." in part else int(part))
    return f"{text}: YAML reads this in base 60, {'-' * (text[0] == '-')}{value}: write that, or '{text}' for text"


class _PlainDumper(yaml.SafeDumper):
    """Write an object that occurs twice in full both times, without a YAML reference."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_PlainDumper.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("+-.0123456789"))  # quotes such text


def to_yaml(content: Mapping[str, Any], **style: Any) -> str:
    """Return the text of a YAML file: fields in their order, no references.

    Args:
        content: plain values.
        style: PyYAML's options, such as ``width``.
    """
    text: str = yaml.dump(dict(content), Dumper=_PlainDumper, sort_keys=False, **style)
    return text
