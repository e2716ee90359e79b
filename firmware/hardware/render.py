#!/usr/bin/env python3
"""Draws unlit-flash.svg from the KiCad schematic, and derives its nets.

    python3 render.py            write unlit-flash.svg
    python3 render.py --check    exit with 1 if unlit-flash.svg is not what the schematic gives
    python3 render.py --nets     print the nets

The schematic is the source: edit it in KiCad (6 or newer), then run this. It knows what that file uses: one sheet,
symbols that may be turned and mirrored, wires, junctions, labels, notes. The nets go into the drawing's metadata, so
that a test can hold drawing and schematic against each other.
"""

import math
import sys
from pathlib import Path
from xml.sax.saxutils import escape

HERE = Path(__file__).resolve().parent
SCHEMATIC = HERE / "unlit-flash.kicad_sch"
DRAWING = HERE / "unlit-flash.svg"

PAGE = (297.0, 210.0)
MARGIN = 10.0
INK, WIRE, LABEL, BODY, NOTE = "#1a1a1a", "#0a5c36", "#8a1c1c", "#fff8dc", "#33507a"
# A stroke font's size is the height of its capitals, an outline font's that of its line.
FONT_SCALE = 1.42


# ---- S-expressions: a list is [name, ...], an atom is a string ----


def parse(text):
    at = 0

    def atom():
        nonlocal at
        if text[at] == '"':
            at += 1
            out = []
            while text[at] != '"':
                if text[at] == "\\":
                    at += 1
                    out.append("\n" if text[at] == "n" else text[at])
                else:
                    out.append(text[at])
                at += 1
            at += 1
            return "".join(out)
        start = at
        while text[at] not in ' \t\r\n()"':
            at += 1
        return text[start:at]

    stack = [[]]
    while at < len(text):
        char = text[at]
        if char in " \t\r\n":
            at += 1
        elif char == "(":
            stack.append([])
            at += 1
        elif char == ")":
            done = stack.pop()
            stack[-1].append(done)
            at += 1
        else:
            stack[-1].append(atom())
    return stack[0][0]


def every(node, name):
    return [child for child in node if isinstance(child, list) and child and child[0] == name]


def first(node, name, default=None):
    return next(iter(every(node, name)), default)


def numbers(node):
    return [float(value) for value in node[1:] if not isinstance(value, list)]


def points(node):
    return [tuple(numbers(xy)) for xy in every(first(node, "pts"), "xy")]


# ---- symbols ----


class Symbol:
    def __init__(self, node, library):
        self.node = node
        self.part = library[first(node, "lib_id")[1]]
        self.x, self.y, self.angle = numbers(first(node, "at"))
        mirror = first(node, "mirror")
        self.mirror = mirror[1] if mirror else ""
        self.power = first(self.part, "power") is not None
        fields = {field[1]: field for field in every(node, "property")}
        self.fields = [fields["Reference"], fields["Value"]]
        self.reference, self.value = fields["Reference"][2], fields["Value"][2]

    def place(self, x, y):
        """From the symbol's coordinates (y up) to the sheet's (y down)."""
        a = math.radians(self.angle)
        x, y = x * math.cos(a) - y * math.sin(a), x * math.sin(a) + y * math.cos(a)
        if self.mirror == "y":
            x = -x
        if self.mirror == "x":
            y = -y
        return round(self.x + x, 3), round(self.y - y, 3)

    def graphics(self):
        for unit in every(self.part, "symbol"):
            yield from (child for child in unit if isinstance(child, list) and child[0] != "pin")

    def pins(self):
        for unit in every(self.part, "symbol"):
            for pin in every(unit, "pin"):
                x, y, angle = numbers(first(pin, "at"))
                length = numbers(first(pin, "length"))[0]
                a = math.radians(angle)
                inner = (x + length * math.cos(a), y + length * math.sin(a))
                yield {
                    "number": first(pin, "number")[1],
                    "name": first(pin, "name")[1],
                    "end": self.place(x, y),
                    "inner": self.place(*inner),
                    "hidden": "hide" in pin,
                    "no_connect": pin[1] == "no_connect",
                }


class Sheet:
    def __init__(self, text):
        self.root = parse(text)
        library = {part[1]: part for part in every(first(self.root, "lib_symbols"), "symbol")}
        self.symbols = [Symbol(node, library) for node in every(self.root, "symbol")]
        self.wires = [points(wire) for wire in every(self.root, "wire")]
        self.junctions = [tuple(numbers(first(j, "at"))) for j in every(self.root, "junction")]
        self.labels = [
            (label[1], numbers(first(label, "at")), kind)
            for kind in ("label", "global_label")
            for label in every(self.root, kind)
        ]

    def nets(self):
        """{name: [REF.PIN, ...]}; a net without a name is called after its first pin."""
        parent = {}

        def find(key):
            parent.setdefault(key, key)
            while parent[key] != key:
                key = parent[key]
            return key

        def join(a, b):
            parent[find(a)] = find(b)

        def at(x, y):
            return round(x * 1000), round(y * 1000)

        def on(point, wire):
            (x, y), (x1, y1), (x2, y2) = point, at(*wire[0]), at(*wire[1])
            straight = (x2 - x1) * (y - y1) == (y2 - y1) * (x - x1)
            return straight and min(x1, x2) <= x <= max(x1, x2) and min(y1, y2) <= y <= max(y1, y2)

        def attach(point):
            for wire in self.wires:
                if on(point, wire):
                    join(point, at(*wire[0]))

        for wire in self.wires:
            join(at(*wire[0]), at(*wire[1]))
        for junction in self.junctions:
            attach(at(*junction))
        for name, (x, y, _), _ in self.labels:
            attach(at(x, y))
            join(at(x, y), name)
        for symbol in self.symbols:
            for pin in symbol.pins():
                attach(at(*pin["end"]))
                # A power symbol names its net and is no part.
                join(at(*pin["end"]), symbol.value if symbol.power else f"{symbol.reference}.{pin['number']}")

        groups = {}
        for key in list(parent):
            if isinstance(key, str):
                groups.setdefault(find(key), []).append(key)
        out = {}
        for members in groups.values():
            ends = sorted(member for member in members if "." in member)
            names = sorted(member for member in members if "." not in member)
            if len(ends) > 1:
                out["/".join(names) or f"at {ends[0]}"] = ends
        return dict(sorted(out.items()))


# ---- SVG ----


class Drawing:
    def __init__(self):
        self.parts = []

    def path(self, pts, width=0.25, colour=INK, fill="none", dash=""):
        d = "M" + " L".join(f"{x:g} {y:g}" for x, y in pts)
        extra = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(f'<path d="{d}" fill="{fill}" stroke="{colour}" stroke-width="{width:g}"{extra}/>')

    def circle(self, centre, radius, width=0.25, colour=INK, fill="none"):
        x, y = centre
        self.parts.append(
            f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}" stroke="{colour}" stroke-width="{width:g}"/>'
        )

    def text(self, words, x, y, size=1.27, anchor="middle", colour=INK, bold=False, rise=0.36):
        """`rise`: how far below the point the base line runs, in capital heights."""
        size *= FONT_SCALE
        weight = ' font-weight="bold"' if bold else ""
        for line, row in enumerate(words.split("\n")):
            self.parts.append(
                f'<text x="{x:g}" y="{y + rise * size + line * size * 1.15:g}" font-size="{size:.3g}" '
                f'text-anchor="{anchor}" fill="{colour}"{weight}>{escape(row)}</text>'
            )


def font(node):
    effects = first(node, "effects")
    face = first(effects, "font")
    justify = first(effects, "justify", [])
    anchor = "start" if "left" in justify else "end" if "right" in justify else "middle"
    return numbers(first(face, "size"))[0], anchor, "bold" in face, "bottom" in justify


def draw_symbol(out, symbol):
    for shape in symbol.graphics():
        width = numbers(first(first(shape, "stroke"), "width"))[0] or 0.25 if first(shape, "stroke") else 0.25
        kind = first(shape, "fill")
        fill = {"background": BODY, "outline": INK}.get(first(kind, "type")[1] if kind else "", "none")
        if shape[0] == "polyline":
            out.path([symbol.place(*xy) for xy in points(shape)], width, fill=fill)
        elif shape[0] == "rectangle":
            (x1, y1), (x2, y2) = numbers(first(shape, "start")), numbers(first(shape, "end"))
            corners = [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]
            out.path([symbol.place(*xy) for xy in corners], width, fill=fill)
        elif shape[0] == "circle":
            out.circle(symbol.place(*numbers(first(shape, "center"))), numbers(first(shape, "radius"))[0], width, fill=fill)
    numbered = "hide" not in first(symbol.part, "pin_numbers", [])
    named = "hide" not in first(symbol.part, "pin_names", [])
    for pin in symbol.pins():
        if pin["hidden"]:
            continue
        (x1, y1), (x2, y2) = pin["end"], pin["inner"]
        out.path([pin["end"], pin["inner"]], 0.18)
        if numbered:
            out.text(pin["number"], (x1 + x2) / 2, y1 - 0.9, 0.9, colour=NOTE)
        if named:
            # The name stands inside, beyond the pin's inner end.
            if y1 == y2:
                step = 0.8 if x2 > x1 else -0.8
                out.text(pin["name"], x2 + step, y2, anchor="start" if step > 0 else "end")
            else:
                out.text(pin["name"], x2, y2 + (1.8 if y2 > y1 else -1.8))
    for field in symbol.fields:
        if "hide" in first(field, "effects"):
            continue
        x, y, _ = numbers(first(field, "at"))
        size, anchor, bold, _ = font(field)
        out.text(field[2], x, y, size, anchor, bold=bold or field[1] == "Reference")


def draw_label(out, name, place, kind):
    x, y, angle = place
    if kind == "label":
        out.text(name, x, y - 0.4, 1.0, "start", LABEL, rise=0)
        return
    side = -1 if angle == 180 else 1
    length = 2.2 + 1.25 * len(name)
    tip = [(x, y), (x + side * 1.2, y - 1.2), (x + side * length, y - 1.2), (x + side * length, y + 1.2)]
    out.path(tip + [(x + side * 1.2, y + 1.2), (x, y)], 0.2, LABEL, "#ffffff")
    out.text(name, x + side * (length + 1.0) / 2, y, 1.27, colour=LABEL)


def draw_frame(out, root):
    width, height = PAGE
    corners = [(MARGIN, MARGIN), (width - MARGIN, MARGIN), (width - MARGIN, height - MARGIN), (MARGIN, height - MARGIN)]
    out.path(corners + corners[:1], 0.3)
    block = first(root, "title_block")
    left, top = width - MARGIN - 108, height - MARGIN - 24
    out.path([(left, height - MARGIN), (left, top), (width - MARGIN, top)], 0.3)
    out.path([(left, top + 14), (width - MARGIN, top + 14)], 0.2)
    out.text(first(block, "title")[1], left + 3, top + 5, 2.2, "start", bold=True)
    remarks = [comment[2] for comment in every(block, "comment")]
    out.text(remarks[0], left + 3, top + 10.5, 1.27, "start")
    out.text(remarks[1], left + 3, top + 19, 1.27, "start", bold=True)
    issue = f"{first(block, 'date')[1]}   rev {first(block, 'rev')[1]}   {first(root, 'paper')[1]}"
    out.text(issue, width - MARGIN - 3, top + 19, 1.27, "end")


def svg(sheet):
    out = Drawing()
    draw_frame(out, sheet.root)
    for line in every(sheet.root, "polyline"):
        style = first(line, "stroke")
        dashed = first(style, "type")[1] != "solid" and first(style, "type")[1] != "default"
        out.path(points(line), numbers(first(style, "width"))[0] or 0.15, NOTE, dash="1.6 1" if dashed else "")
    for wire in sheet.wires:
        out.path(wire, 0.25, WIRE)
    for symbol in sheet.symbols:
        draw_symbol(out, symbol)
    for junction in sheet.junctions:
        out.circle(junction, 0.45, 0.1, WIRE, WIRE)
    for cross in every(sheet.root, "no_connect"):
        x, y = numbers(first(cross, "at"))
        out.path([(x - 0.7, y - 0.7), (x + 0.7, y + 0.7)], 0.2, NOTE)
        out.path([(x - 0.7, y + 0.7), (x + 0.7, y - 0.7)], 0.2, NOTE)
    for name, place, kind in sheet.labels:
        draw_label(out, name, place, kind)
    for note in every(sheet.root, "text"):
        x, y, _ = numbers(first(note, "at"))
        size, anchor, bold, _ = font(note)
        # KiCad sets the last line of a note on its point.
        lines = note[1].count("\n")
        out.text(note[1], x, y - lines * size * FONT_SCALE * 1.15, size, anchor, NOTE, bold, rise=0)

    nets = "\n".join(f"{name}: {' '.join(ends)}" for name, ends in sheet.nets().items())
    width, height = PAGE
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" font-family="Helvetica, Arial, sans-serif">\n'
        "<title>unlit flash controller, schematic</title>\n"
        f'<metadata id="nets">\n{escape(nets)}\n</metadata>\n'
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>\n'
        '<g stroke-linecap="round" stroke-linejoin="round">\n'
    )
    # Letters have no stroke of their own: each text element leaves it unset.
    return head + "\n".join(out.parts) + "\n</g>\n</svg>\n"


def main(arguments):
    sheet = Sheet(SCHEMATIC.read_text(encoding="utf-8"))
    if arguments == ["--nets"]:
        for name, ends in sheet.nets().items():
            print(f"{name}: {' '.join(ends)}")
        return 0
    drawn = svg(sheet)
    if arguments == ["--check"]:
        if DRAWING.exists() and DRAWING.read_text(encoding="utf-8") == drawn:
            return 0
        print(f"{DRAWING.name} is not what {SCHEMATIC.name} gives: run python3 {Path(__file__).name}", file=sys.stderr)
        return 1
    if arguments:
        print(__doc__, file=sys.stderr)
        return 2
    DRAWING.write_text(drawn, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
