"""Compression of pictures that are mostly flat, as labels and cut-out depth are: PNG's filter "up", then deflate.

General compressors look at every byte; here a run of pixels becomes a few tokens at once: those that are like the
pixels above are bytes of 0, and those that differ from above in the same way repeat a pixel. The stream is one block
with its own Huffman code (RFC 1950 and 1951).
"""

import numba
import numpy as np

#: Begins every row: what is stored is the difference from the row above.
_UP = 2
#: The symbol that ends the stream; those below are bytes, those above lengths.
_END = 256
_SYMBOLS = 286
#: Codes of distances: 1 to 4 bytes back.
_DISTANCES = 4
#: Of the 29 codes for lengths of 3 to 258 bytes: the shortest length, and the bits that tell how much longer it is.
_EXTRA = np.array([0] * 8 + [bits for bits in range(1, 6) for _ in range(4)] + [0])
_BASE = np.append(3 + np.append(0, np.cumsum(1 << _EXTRA[:-2])), 258)
_CODE = np.searchsorted(_BASE, np.arange(259), side="right") - 1
_LONGEST, _SHORTEST = 258, 3
_LONGEST_CODE = 15
#: Modulus of Adler's checksum.
_ADLER = 65521
#: What a block with its own code begins with, and in how many bits: that it is the last one, its kind, the numbers of
#: codes for literals and lengths, for distances, and for code lengths. The lengths' own code has 4 bits for 0 to 15;
#: it stands in this order.
_HEAD = np.array(
    [(1, 1), (2, 2), (_SYMBOLS - 257, 5), (_DISTANCES - 1, 5), (19 - 4, 4)]
    + [(4 if i < 16 else 0, 3) for i in (16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15)]
)


def deflate(values, colours):
    """The zlib stream of a PNG whose pixels are ``colours[values]``.

    Args:
        values: (h, w) of at least one pixel, from 0, below the number of colours.
        colours: (n, 1 to 4) bytes of a pixel.
    """
    return _stream(*_tokens(values, colours), colours.shape[1])


@numba.njit(cache=True, nogil=True)
def _stream(tokens, adler, size):
    """The zlib stream of tokens, of pixels of ``size`` bytes."""
    counts = np.zeros(_SYMBOLS, np.int64)
    for token in tokens:
        counts[token & 511] += 1
    lengths = _code_lengths(counts)
    codes = _codes(lengths)
    # At most 5 bits more for a length, and one for the distance.
    most = 8 * 256
    for i in range(_SYMBOLS):
        most += counts[i] * (lengths[i] + 6)
    out = np.empty(most // 8, np.uint8)
    out[0], out[1] = 0x78, 0x01
    state = (0, 0, 2)
    for i in range(_HEAD.shape[0]):
        state = _put(out, state, _HEAD[i, 0], _HEAD[i, 1])
    for i in range(_SYMBOLS):
        state = _put(out, state, _reversed(lengths[i], 4), 4)
    other = size - 1 if size > 1 else _DISTANCES - 1
    for i in range(_DISTANCES):
        state = _put(out, state, _reversed(1 if i == 0 or i == other else 0, 4), 4)
    for token in tokens:
        symbol = token & 511
        value, bits = codes[symbol], lengths[symbol]
        if symbol > _END:
            value |= (token >> 10) << bits
            bits += _EXTRA[symbol - 257]
            value |= ((token >> 9) & 1) << bits
            bits += 1
        state = _put(out, state, value, bits)
    end = _put(out, state, 0, 7)[2]  # what is left of the last byte
    for i in range(4):
        out[end + i] = (adler >> (24 - 8 * i)) & 255
    return out[: end + 4]


@numba.njit(cache=True, nogil=True)
def _tokens(values, colours):
    """What is to be coded, and the checksum of the bytes that it stands for.

    A token is a symbol of the alphabet of literals and lengths. For a length, bit 9 tells whether it repeats a byte or
    a pixel, and above it stands what the length is more than the symbol's.
    """
    height, width = values.shape
    size = colours.shape[1]
    tokens = np.empty(height * (width * size + 1) + 1, np.int32)
    count = 0
    a, b = 1, 0
    pixel, nothing = np.empty(size, np.uint8), np.zeros(size, np.uint8)
    for v in range(height):
        tokens[count] = last = _UP
        count += 1
        a = (a + _UP) % _ADLER
        b = (b + a) % _ADLER
        u = 0
        while u < width:
            first = u
            while v > 0 and u < width and values[v, u] == values[v - 1, u]:
                u += 1
            if u > first:
                zeros = (u - first) * size
                b = (b + zeros * a) % _ADLER
                if last != 0:
                    tokens[count] = last = 0
                    count += 1
                    zeros -= 1
                count = _repeat(tokens, count, nothing, zeros, 0)
                if u == width:
                    break
            first = u
            value, above = values[v, u], values[max(v - 1, 0), u]
            total = weighted = 0
            for k in range(size):
                last = (colours[value, k] - (colours[above, k] if v > 0 else 0)) & 255
                pixel[k] = tokens[count] = last
                count += 1
                total += last
                weighted += (size - k) * last
            while u < width and values[v, u] == value and (v == 0 or values[v - 1, u] == above):
                u += 1
            run = u - first
            b = (b + run * (size * a + weighted) + size * total * (run * (run - 1) // 2)) % _ADLER
            a = (a + run * total) % _ADLER
            count = _repeat(tokens, count, pixel, (run - 1) * size, 1 if size > 1 else 0)
    tokens[count] = _END
    return tokens[: count + 1], (b << 16) | a


@numba.njit(cache=True, nogil=True)
def _repeat(tokens, count, pixel, length, by_pixel):
    """Append tokens for so many bytes that repeat the pixel before; returns the new count."""
    while length >= _SHORTEST:
        part = min(length, _LONGEST)
        if 0 < length - part < _SHORTEST:
            part -= _SHORTEST
        code = _CODE[part]
        tokens[count] = (257 + code) | by_pixel << 9 | (part - _BASE[code]) << 10
        count += 1
        length -= part
    for k in range(length):
        tokens[count] = pixel[k % pixel.size]
        count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _code_lengths(counts):
    """Bits of each symbol in a Huffman code of at most 15; 0 for symbols that do not occur. At least two must."""
    lengths = np.zeros(counts.size, np.int64)
    weights = counts.copy()
    while True:
        order, n = _by_weight(weights)
        # Leaves by weight, then the nodes over them in the order they are made, which is by weight too.
        tree = np.empty(2 * n - 1, np.int64)
        for i in range(n):
            tree[i] = weights[order[i]]
        parents = np.zeros(2 * n - 1, np.int64)
        leaf, node = 0, n
        for new in range(n, 2 * n - 1):
            tree[new] = 0
            for _ in range(2):
                if node == new or (leaf < n and tree[leaf] <= tree[node]):
                    child, leaf = leaf, leaf + 1
                else:
                    child, node = node, node + 1
                parents[child] = new
                tree[new] += tree[child]
        depths = np.zeros(2 * n - 1, np.int64)
        deepest = 0
        for i in range(2 * n - 3, -1, -1):
            depths[i] = depths[parents[i]] + 1
            deepest = max(deepest, depths[i])
        if deepest <= _LONGEST_CODE:
            for i in range(n):
                lengths[order[i]] = depths[i]
            return lengths
        for i in range(weights.size):
            weights[i] = (weights[i] + 1) // 2  # more alike: a flatter tree


@numba.njit(cache=True, nogil=True)
def _by_weight(weights):
    """The symbols that occur, the rarest first, and how many they are. By insertion, which compiles quickly."""
    order = np.empty(weights.size, np.int64)
    n = 0
    for symbol in range(weights.size):
        if weights[symbol] > 0:
            k = n
            while k > 0 and weights[order[k - 1]] > weights[symbol]:
                order[k] = order[k - 1]
                k -= 1
            order[k] = symbol
            n += 1
    return order, n


@numba.njit(cache=True, nogil=True)
def _codes(lengths):
    """The canonical code (RFC 1951, 3.2.2) with its bits reversed, as they are written."""
    codes = np.zeros(lengths.size, np.int64)
    code = 0
    for length in range(1, _LONGEST_CODE + 1):
        code <<= 1
        for symbol in range(lengths.size):
            if lengths[symbol] == length:
                codes[symbol] = _reversed(code, length)
                code += 1
    return codes


@numba.njit(cache=True, nogil=True)
def _reversed(value, size):
    out = 0
    for _ in range(size):
        out = out << 1 | value & 1
        value >>= 1
    return out


@numba.njit(cache=True, nogil=True)
def _put(out, state, value, size):
    """Write so many bits. The state: bits that do not fill a byte yet, how many they are, and the bytes written."""
    bits, held, at = state
    bits |= value << held
    held += size
    while held >= 8:
        out[at] = bits & 255
        at += 1
        bits >>= 8
        held -= 8
    return bits, held, at
