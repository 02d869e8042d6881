//! The file as it is written.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::lines;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct File {
    pub who: Vec<Group>,
    pub frames: Frames,
    pub order: Order,
    pub typos: BTreeMap<String, String>,
    pub verbs: BTreeMap<String, String>,
    pub style: Vec<Style>,
    pub action: Vec<Action>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Group {
    pub weight: u32,
    pub names: String,
    pub whom: Option<String>,
    pub they: String,
    pub their: String,
    pub themself: String,
    pub are: String,
    pub were: String,
    #[serde(default)]
    pub plural: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frames {
    #[serde(rename = "do")]
    pub action: String,
    pub thing: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Order {
    pub two: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Style {
    pub name: String,
    #[serde(default)]
    pub accept: Vec<String>,
    pub adverb: String,
    pub adjective: String,
    pub manner: String,
    pub lead: String,
    pub person: String,
    #[serde(default)]
    pub walk: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Action {
    pub name: String,
    #[serde(rename = "do")]
    pub verbs: String,
    pub thing: String,
    pub say: String,
}

impl From<Group> for super::Group {
    fn from(group: Group) -> Self {
        let Group { weight, names, whom, they, their, themself, are, were, plural } = group;
        super::Group { weight, names: lines(&names), whom, they, their, themself, are, were, plural }
    }
}

impl From<Style> for super::Style {
    fn from(style: Style) -> Self {
        let [adverb, adjective, manner, lead, person, walk] =
            [&style.adverb, &style.adjective, &style.manner, &style.lead, &style.person, &style.walk]
                .map(|text| lines(text));
        super::Style { name: style.name, accept: style.accept, adverb, adjective, manner, lead, person, walk }
    }
}

impl From<Action> for super::Action {
    fn from(action: Action) -> Self {
        super::Action { name: action.name, kinds: [lines(&action.verbs), lines(&action.thing), lines(&action.say)] }
    }
}
