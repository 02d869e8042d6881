//! Forms of English verbs.

use super::{Group, Phrases};

/// Form of a verb.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    Base,
    /// As the subject asks.
    Agree,
    Ing,
    Past,
}

/// The slots of a verb phrase in each of its forms.
pub(super) const FORMS: [(&str, Form); 4] =
    [("do", Form::Base), ("does", Form::Agree), ("doing", Form::Ing), ("did", Form::Past)];

impl Phrases {
    /// A form of a verb for a subject.
    pub(super) fn inflect(&self, verb: &str, form: Form, who: &Group) -> String {
        match form {
            Form::Agree if verb == "be" => return who.are.clone(),
            Form::Past if verb == "be" => return who.were.clone(),
            Form::Base => return verb.to_owned(),
            Form::Agree if who.plural => return verb.to_owned(),
            _ => {}
        }
        if let Some([third, ing, past]) = self.verbs.get(verb) {
            return match form {
                Form::Ing => ing,
                Form::Past => past,
                _ => third,
            }
            .clone();
        }
        let vowel = |c: char| matches!(c, 'a' | 'e' | 'i' | 'o' | 'u');
        let cut = |ending: &str| verb.strip_suffix(ending);
        // Carry, not play.
        let carry = cut("y").filter(|stem| !stem.ends_with(vowel));
        match (form, carry) {
            (Form::Agree, Some(stem)) => return format!("{stem}ies"),
            (Form::Agree, None) => {
                let hissing = ["s", "x", "z", "ch", "sh", "o"].iter().any(|ending| verb.ends_with(ending));
                return format!("{verb}{}", if hissing { "es" } else { "s" });
            }
            (Form::Past, Some(stem)) => return format!("{stem}ied"),
            _ => {}
        }
        let ending = if form == Form::Ing { "ing" } else { "ed" };
        if let (Form::Ing, Some(stem)) = (form, cut("ie")) {
            return format!("{stem}ying");
        }
        if let Some(stem) = cut("e") {
            let keeps = ["ee", "oe", "ye"].iter().any(|ending| verb.ends_with(ending));
            return match form {
                Form::Past => format!("{verb}d"),
                _ if keeps => format!("{verb}ing"),
                _ => format!("{stem}ing"),
            };
        }
        // One syllable, one vowel, one consonant: hop, not help, look or gallop.
        let sound = |c: char| vowel(c) || c == 'y';
        let groups = verb.split(|c| !sound(c)).filter(|part| !part.is_empty()).count();
        let mut back = verb.chars().rev();
        let doubled = match (back.next(), back.next(), back.next()) {
            (Some(last), Some(middle), before) if groups == 1 => {
                !sound(last) && !matches!(last, 'w' | 'x') && vowel(middle) && before.is_none_or(|c| !sound(c))
            }
            _ => false,
        };
        let again = if doubled { verb.get(verb.len() - 1..).unwrap_or_default() } else { "" };
        format!("{verb}{again}{ending}")
    }
}
