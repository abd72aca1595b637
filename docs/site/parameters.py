"""Shows the parameters of Python functions as lists.

The docstrings of the package describe parameters in a paragraph: `log: an MCAP file. topic: the topic of the lidar.`
"""

import re

import griffe


def with_lists(text, names):
    """The docstring, with a list item for each description of one or more parameters of these names."""
    if not names:
        return text
    name = "|".join(map(re.escape, sorted(names)))
    # At the start of a line, or after a sentence.
    start = re.compile(rf"(?:^|(?<=[.;]) )((?:{name})(?:, (?:{name}))*): ", re.MULTILINE)
    paragraphs = []
    for paragraph in text.split("\n\n"):
        if start.match(paragraph):
            paragraph = start.sub(lambda match: f"\n- `{match[1].replace(', ', '`, `')}`: ", paragraph)
            paragraph = re.sub(r"\n+- ", "\n- ", paragraph).strip()
        paragraphs.append(paragraph)
    return "\n\n".join(paragraphs)


class Parameters(griffe.Extension):
    def on_function(self, *, func, **_):
        if func.docstring:
            func.docstring.value = with_lists(func.docstring.value, {parameter.name for parameter in func.parameters})


assert with_lists("A.\n\na, b: 1. c: 2;\nd: 3.", {"a", "b", "c"}) == "A.\n\n- `a`, `b`: 1.\n- `c`: 2;\nd: 3."
