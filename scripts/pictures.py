"""Reads, halves, joins and writes PNG pictures, with Python's standard library only."""
import collections
import struct
import zlib

WHITE = b"\xff\xff\xff"


class Picture:
    """Rows of pixels with 8 bits each of red, green and blue."""

    def __init__(self, rows):
        self.rows = rows
        self.width, self.height = len(rows[0]) // 3, len(rows)

    @classmethod
    def read(cls, path):
        """Reads a picture with 8 bits a channel: grey, colours, a palette, or with transparency, which is ignored."""
        data, place, chunks = path.read_bytes(), 8, collections.defaultdict(bytes)
        while place < len(data):
            length, name = struct.unpack(">I4s", data[place : place + 8])
            chunks[name] += data[place + 8 : place + 8 + length]
            place += length + 12
        width, height, depth, kind = struct.unpack(">IIBB", chunks[b"IHDR"][:10])
        if depth != 8:
            raise ValueError(f"{path}: has {depth} bits a channel; give a picture with 8")
        size = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[kind]
        raw, line, rows = zlib.decompress(chunks[b"IDAT"]), bytearray(width * size), []
        for at in range(0, height * (width * size + 1), width * size + 1):
            line = unfiltered(raw[at], bytearray(raw[at + 1 : at + 1 + width * size]), line, size)
            rows.append(line)
        if kind == 3:
            palette = chunks[b"PLTE"]
            colours = [palette[3 * i : 3 * i + 3] for i in range(len(palette) // 3)]
            rows = [b"".join([colours[i] for i in row]) for row in rows]
        elif size != 3:
            channels = (0, 1, 2) if size == 4 else (0, 0, 0)
            rows = [bytes(row[i + c] for i in range(0, len(row), size) for c in channels) for row in rows]
        return cls(rows)

    def halved(self):
        """Returns the picture with the mean of two by two pixels in place of each four."""
        rows = []
        for up, low in zip(self.rows[::2], self.rows[1::2]):
            row = bytearray(self.width // 2 * 3)
            for c in range(3):
                a, b, e, f = up[c::6], up[c + 3 :: 6], low[c::6], low[c + 3 :: 6]
                row[c::3] = bytes((i + j + k + m + 2) // 4 for i, j, k, m in zip(a, b, e, f))
            rows.append(bytes(row))
        return Picture(rows)

    def joined(self, other, gap=20):
        """Returns both pictures side by side."""
        height = max(self.height, other.height)
        padded = [p.rows + [WHITE * p.width] * (height - p.height) for p in (self, other)]
        return Picture([bytes(a) + WHITE * gap + bytes(b) for a, b in zip(*padded)])

    def write(self, path):
        """Writes the picture with the 256 colours that are nearest to its own."""
        counts = collections.Counter()
        for row in self.rows:
            counts.update(zip(row[::3], row[1::3], row[2::3]))
        bins = collections.defaultdict(list)
        for color, count in counts.items():
            bins[tuple(c >> 3 for c in color)].append((count, color))
        common = sorted(bins.values(), key=lambda found: (-sum(count for count, _ in found), min(found)))
        palette = [max(found, key=lambda entry: (entry[0], entry[1]))[1] for found in common[:256]]
        nearest = lambda color: min(range(len(palette)), key=lambda i: sum((p - c) ** 2 for p, c in zip(palette[i], color)))
        numbers = {}
        for found in bins.values():
            number = nearest(max(found)[1])
            numbers.update((color, number) for _, color in found)
        raw = b"".join(b"\0" + bytes(map(numbers.__getitem__, zip(r[::3], r[1::3], r[2::3]))) for r in self.rows)
        chunk = lambda name, data: struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        path.write_bytes(b"\x89PNG\r\n\x1a\n"
                         + chunk(b"IHDR", struct.pack(">IIBBBBB", self.width, self.height, 8, 3, 0, 0, 0))
                         + chunk(b"PLTE", b"".join(map(bytes, palette)))
                         + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b""))

    def difference(self, other):
        """Returns the mean difference of two pictures, from 0 to 255; infinity if their sizes differ."""
        if (self.width, self.height) != (other.width, other.height):
            return float("inf")
        sums = sum(abs(a - b) for one, two in zip(self.rows, other.rows) for a, b in zip(one, two))
        return sums / (3 * self.width * self.height)


def unfiltered(kind, line, above, size):
    """Returns a line of a PNG without its filter, given the line above."""
    if kind == 1:
        for i in range(size, len(line)):
            line[i] = (line[i] + line[i - size]) & 255
    elif kind == 2:
        line = bytearray((a + b) & 255 for a, b in zip(line, above))
    elif kind == 3:
        for i in range(len(line)):
            left = line[i - size] if i >= size else 0
            line[i] = (line[i] + (left + above[i]) // 2) & 255
    elif kind == 4:
        for i in range(len(line)):
            left, corner = (line[i - size], above[i - size]) if i >= size else (0, 0)
            up = above[i]
            p, q, r = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
            line[i] = (line[i] + (left if p <= q and p <= r else up if q <= r else corner)) & 255
    return line
