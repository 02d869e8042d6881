//! From text to a robot: values with their places, and everything that is wrong with them.

use std::collections::BTreeMap;
use std::ops::Range;

use motionette::playback::robot::MAX_CHANNELS;
use motionette::playback::{Rest, Robot};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::channel::{self, CHANNEL_KEYS, DEFAULT_KEYS, Placed};
use super::error::Problem;
use super::violations;

/// Keys of the whole robot.
const ROBOT_KEYS: [&str; 10] = [
    "name",
    "tick_rate",
    "fade",
    "return_time",
    "after",
    "finish_without_host",
    "creep",
    "output_enable",
    "defaults",
    "channel",
];

/// Degrees a second at which a robot creeps that does not say it.
pub(super) const CREEP: f32 = 20.0;

/// Bytes of the text.
pub(super) type Span = Range<usize>;

/// A text and what is wrong with it.
pub(super) struct Reader<'s> {
    source: &'s str,
    problems: Vec<Problem>,
}

/// Where the keys of a table stand.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// The table's head.
    pub head: Span,
    /// Values by key, and whether they are what they should be.
    keys: BTreeMap<&'static str, (Span, bool)>,
}

impl Places {
    /// Where the first of these keys that was given stands; else the table's head.
    pub fn of(&self, keys: &[&str]) -> Span {
        let place = keys.iter().find_map(|key| self.keys.get(key));
        place.map_or(self.head.clone(), |(span, _)| span.clone())
    }

    /// Notes that a complaint about this key has been made, or that it is missing.
    pub fn broken(&mut self, key: &'static str) {
        let head = self.head.clone();
        self.keys.entry(key).or_insert((head, false)).1 = false;
    }

    /// Whether every one of these keys that was given is what it should be.
    pub fn sound(&self, keys: &[&str]) -> bool {
        keys.iter().all(|key| self.keys.get(key).is_none_or(|(_, sound)| *sound))
    }
}

/// A table, and what stands in for keys that it does not have.
pub(super) struct Table<'t, 'i> {
    pub own: &'t DeTable<'i>,
    pub defaults: Option<&'t DeTable<'i>>,
    pub places: Places,
}

impl<'t, 'i> Table<'t, 'i> {
    pub fn new(own: &'t DeTable<'i>, defaults: Option<&'t DeTable<'i>>, head: Span) -> Self {
        Table { own, defaults, places: Places { head, ..Places::default() } }
    }

    /// The value of a key; its place is noted.
    pub fn get(&mut self, key: &'static str) -> Option<&'t Spanned<DeValue<'i>>> {
        let value = self.own.get(key).or_else(|| self.defaults?.get(key))?;
        self.places.keys.insert(key, (value.span(), true));
        Some(value)
    }
}

impl<'s> Reader<'s> {
    /// Notes a problem, unless it has been noted: a wrong default is wrong for every channel.
    pub fn report(&mut self, span: Span, message: impl Into<String>) {
        let problem = Problem::new(self.source, span, message.into());
        if !self.problems.contains(&problem) {
            self.problems.push(problem);
        }
    }

    pub fn source(&self) -> &'s str {
        self.source
    }

    /// What `read` makes of the value of a key. `expected` says in a complaint what it should be.
    pub fn value<'t, 'i, T>(
        &mut self,
        table: &mut Table<'t, 'i>,
        key: &'static str,
        expected: &str,
        read: impl FnOnce(&'t DeValue<'i>) -> Option<T>,
    ) -> Option<T> {
        let value = table.get(key)?;
        let found = read(value.get_ref());
        if found.is_none() {
            let kind = match value.get_ref() {
                DeValue::Integer(number) => number.to_string(),
                DeValue::Float(number) => number.to_string(),
                DeValue::String(text) => format!("{text:?}"),
                DeValue::Boolean(value) => value.to_string(),
                DeValue::Array(list) => format!("this list of {}", list.len()),
                other => format!("a {}", other.type_str()),
            };
            self.report(value.span(), format!("{key} must be {expected}, not {kind}"));
            table.places.broken(key);
        }
        found
    }

    /// A number.
    pub fn number(&mut self, table: &mut Table<'_, '_>, key: &'static str, unit: &str) -> Option<f32> {
        self.value(table, key, &format!("a number{unit}"), number)
    }

    /// A whole number that fits `T`.
    pub fn whole<T: TryFrom<i64>>(&mut self, table: &mut Table<'_, '_>, key: &'static str, most: u64) -> Option<T> {
        self.value(table, key, &format!("a whole number from 0 to {most}"), whole)
    }

    /// A text of at most `N` bytes.
    pub fn text<const N: usize>(
        &mut self,
        table: &mut Table<'_, '_>,
        key: &'static str,
    ) -> Option<heapless::String<N>> {
        self.value(table, key, &format!("a text of at most {N} bytes in quotes"), |value| {
            heapless::String::try_from(value.as_str()?).ok()
        })
    }

    /// One of some words.
    pub fn word<T: Copy>(
        &mut self,
        table: &mut Table<'_, '_>,
        key: &'static str,
        words: &[(&'static str, T)],
    ) -> Option<T> {
        let names: Vec<&str> = words.iter().map(|(name, _)| *name).collect();
        let expected = format!("one of \"{}\"", names.join("\", \""));
        self.value(table, key, &expected, |value| {
            let found = value.as_str()?;
            words.iter().find(|(name, _)| *name == found).map(|(_, word)| *word)
        })
    }

    /// Complains about keys that nobody knows, or that stand in the wrong place. Gives those that were probably meant.
    pub fn unknown_keys<'k>(&mut self, table: &DeTable<'_>, what: &str, known: &[&'k str]) -> Vec<&'k str> {
        let mut meant = Vec::new();
        for key in table.keys().filter(|key| !known.contains(&&**key.get_ref())) {
            let name: &str = key.get_ref();
            let message = if CHANNEL_KEYS.contains(&name) && known != CHANNEL_KEYS {
                format!("{name} does not belong to {what}: put it below a [[channel]]")
            } else if ROBOT_KEYS.contains(&name) && known != ROBOT_KEYS {
                format!("{name} belongs to the whole robot: put it above the first [table]")
            } else if let Some(near) = nearest(name, known) {
                meant.push(near);
                format!("there is no key {name:?}: did you mean {near}?")
            } else {
                format!("there is no key {name:?}: {what} has {}", known.join(", "))
            };
            self.report(key.span(), message);
        }
        meant
    }
}

pub(super) fn number(value: &DeValue<'_>) -> Option<f32> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        other => whole::<i64>(other).map(|whole| whole as f32),
    }
}

fn whole<T: TryFrom<i64>>(value: &DeValue<'_>) -> Option<T> {
    let integer = value.as_integer()?;
    T::try_from(i64::from_str_radix(integer.as_str(), integer.radix()).ok()?).ok()
}

/// Two of something.
pub(super) fn pair<T>(value: &DeValue<'_>, read: impl Fn(&DeValue<'_>) -> Option<T>) -> Option<[T; 2]> {
    match &**value.as_array()? {
        [a, b] => Some([read(a.get_ref())?, read(b.get_ref())?]),
        _ => None,
    }
}

/// Two commands.
pub(super) fn commands(value: &DeValue<'_>) -> Option<[u16; 2]> {
    pair(value, whole)
}

/// The name that was probably meant.
pub(super) fn nearest<'n>(found: &str, names: &[&'n str]) -> Option<&'n str> {
    let distance = |name: &&&str| strsim::damerau_levenshtein(found, name);
    names.iter().min_by_key(distance).filter(|name| distance(name) <= 1 + found.len() / 4).copied()
}

/// Reads a whole text.
pub(super) fn parse(source: &str) -> Result<Robot, Vec<Problem>> {
    let mut reader = Reader { source, problems: Vec::new() };
    let (document, errors) = DeTable::parse_recoverable(source);
    for error in errors {
        let span = error.span().unwrap_or_default();
        reader.report(span, format!("this is no TOML: {}", error.message().replace('\n', ", ")));
    }
    if !reader.problems.is_empty() {
        // What can be read of a broken text says little about what was meant.
        return Err(reader.problems);
    }
    let document = document.get_ref();
    reader.unknown_keys(document, "the whole robot", &ROBOT_KEYS);
    let mut table = Table::new(document, None, 0..0);
    let mut robot = Robot {
        name: reader.text(&mut table, "name").unwrap_or_default(),
        tick_rate: reader.whole(&mut table, "tick_rate", 1000).unwrap_or(50),
        fade: reader.number(&mut table, "fade", " of seconds").unwrap_or(0.3),
        return_time: reader.number(&mut table, "return_time", " of seconds").unwrap_or(1.5),
        after: reader
            .word(&mut table, "after", &[("hold", Rest::Hold), ("neutral", Rest::Neutral)])
            .unwrap_or_default(),
        finish_without_host: reader
            .value(&mut table, "finish_without_host", "true or false", DeValue::as_bool)
            .unwrap_or(true),
        creep: reader.number(&mut table, "creep", " of degrees a second").unwrap_or(CREEP),
        output_enable: reader.whole(&mut table, "output_enable", 255),
        channels: heapless::Vec::new(),
    };
    let defaults = reader.value(&mut table, "defaults", "a table: [defaults]", DeValue::as_table);
    let meant = defaults.map(|defaults| reader.unknown_keys(defaults, "[defaults]", &DEFAULT_KEYS)).unwrap_or_default();
    let channels = reader.value(&mut table, "channel", "a list of tables: [[channel]]", |value| {
        let tables = value.as_array()?.iter().map(|item| Some((item.get_ref().as_table()?, item.span())));
        tables.collect::<Option<Vec<_>>>()
    });
    let mut placed: Vec<Placed> = Vec::new();
    for (channel, head) in channels.into_iter().flatten() {
        let place = head.clone();
        let (channel, places) = channel::read(&mut reader, Table::new(channel, defaults, head), &meant);
        if robot.channels.push(channel).is_err() {
            reader.report(place, format!("a robot has at most {MAX_CHANNELS} channels"));
            break;
        }
        placed.push(places);
    }
    violations::report(&mut reader, &robot, &table.places, &placed);
    if reader.problems.is_empty() { Ok(robot) } else { Err(reader.problems) }
}
