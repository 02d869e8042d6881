//! Values of JSON in which objects keep fields that stand twice.

use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Number, Value};

use super::Entry;

/// A value.
#[derive(Debug, Clone)]
pub(crate) enum Node {
    /// `null`.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A number.
    Number(Number),
    /// Text.
    Text(String),
    /// A list.
    List(Vec<Node>),
    /// An object.
    Object(Entry),
}

impl Node {
    /// Whether it is `null`.
    pub const fn is_null(&self) -> bool {
        matches!(self, Node::Null)
    }

    /// A number.
    pub fn as_f64(&self) -> Option<f64> {
        if let Node::Number(number) = self { number.as_f64() } else { None }
    }

    /// A whole number that is not negative.
    pub fn as_u64(&self) -> Option<u64> {
        if let Node::Number(number) = self { number.as_u64() } else { None }
    }

    /// A whole number.
    pub fn as_i64(&self) -> Option<i64> {
        if let Node::Number(number) = self { number.as_i64() } else { None }
    }

    /// Text.
    pub const fn as_str(&self) -> Option<&str> {
        if let Node::Text(text) = self { Some(text.as_str()) } else { None }
    }

    /// The items of a list.
    pub const fn as_list(&self) -> Option<&[Node]> {
        if let Node::List(items) = self { Some(items.as_slice()) } else { None }
    }

    /// An object.
    pub const fn as_entry(&self) -> Option<&Entry> {
        if let Node::Object(entry) = self { Some(entry) } else { None }
    }

    /// The same for showing; of fields that stand twice the last.
    fn value(&self) -> Value {
        match self {
            Node::Null => Value::Null,
            Node::Bool(value) => Value::Bool(*value),
            Node::Number(number) => Value::Number(number.clone()),
            Node::Text(text) => Value::String(text.clone()),
            Node::List(items) => items.iter().map(Node::value).collect(),
            Node::Object(Entry(fields)) => {
                Value::Object(fields.iter().map(|(name, node)| (name.clone(), node.value())).collect())
            }
        }
    }
}

/// A number of its digits; text where they say more than a number holds.
fn number(digits: &str) -> Node {
    // A zero below zero is no whole number.
    let signed = || digits.parse::<i64>().ok().filter(|number| *number != 0).map(Number::from);
    let whole = || digits.parse::<u64>().ok().map(Number::from).or_else(signed);
    let number = whole().or_else(|| digits.parse().ok().and_then(Number::from_f64));
    number.map_or_else(|| Node::Text(digits.to_owned()), Node::Number)
}

/// As JSON.
impl fmt::Display for Node {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.value().fmt(f)
    }
}

/// The fields of an object.
pub(super) struct Fields;

impl<'de> Visitor<'de> for Fields {
    type Value = Vec<(String, Node)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with fields")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut fields = Vec::new();
        while let Some(field) = map.next_entry()? {
            fields.push(field);
        }
        Ok(fields)
    }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl<'de> Visitor<'de> for Any {
            type Value = Node;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a value")
            }

            fn visit_unit<E>(self) -> Result<Node, E> {
                Ok(Node::Null)
            }

            fn visit_bool<E>(self, value: bool) -> Result<Node, E> {
                Ok(Node::Bool(value))
            }

            fn visit_u64<E>(self, value: u64) -> Result<Node, E> {
                Ok(Node::Number(value.into()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<Node, E> {
                Ok(Node::Number(value.into()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<Node, E> {
                // JSON has no others than finite ones.
                Ok(Number::from_f64(value).map_or(Node::Null, Node::Number))
            }

            fn visit_str<E>(self, text: &str) -> Result<Node, E> {
                Ok(Node::Text(text.to_owned()))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Node, A::Error> {
                let mut items = Vec::new();
                while let Some(item) = list.next_element()? {
                    items.push(item);
                }
                Ok(Node::List(items))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Node, A::Error> {
                let fields = Fields.visit_map(map)?;
                // Where another crate has the reader keep all digits, a number comes as an object of this one field.
                match fields.as_slice() {
                    [(name, Node::Text(digits))] if name == "$serde_json::private::Number" => Ok(number(digits)),
                    _ => Ok(Node::Object(Entry(fields))),
                }
            }
        }
        deserializer.deserialize_any(Any)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers are numbers whatever other crates want of the JSON reader.
    #[test]
    fn numbers_come_as_digits_as_well() {
        let read = |text: &str| serde_json::from_str::<Node>(text).unwrap();
        let [plain, digits] = ["[3, -2, 0.25, 1e3]", r#"[{"$serde_json::private::Number": "3"}]"#].map(read);
        let numbers: Vec<f64> = plain.as_list().unwrap().iter().map(|item| item.as_f64().unwrap()).collect();
        assert_eq!(numbers, [3.0, -2.0, 0.25, 1000.0]);
        assert_eq!(digits.as_list().unwrap()[0].as_u64(), Some(3));
        for (digits, want) in [("-2", -2.0), ("0.25", 0.25), ("1e3", 1000.0)] {
            assert_eq!(number(digits).as_f64(), Some(want));
        }
        assert!(number("-0").as_f64().is_some_and(f64::is_sign_negative));
        assert_eq!(number("1e999").as_str(), Some("1e999"));
    }
}
