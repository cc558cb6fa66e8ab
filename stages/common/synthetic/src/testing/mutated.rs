//! Data that went wrong in one place, for tests of what consumers make of it.

use super::random::Random;
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::Value;

/// A copy with one number, list or name changed, and which; `None` where the type does not allow the
/// change.
pub fn mutated<T: Serialize + DeserializeOwned>(
    value: &T,
    random: &mut Random,
) -> Option<(T, String)> {
    let mut tree = Value::try_from(value).ok()?;
    let mut place = String::new();
    change(&mut tree, random, &mut place);
    Some((tree.try_into().ok()?, place))
}

fn change(value: &mut Value, random: &mut Random, place: &mut String) {
    const FLOATS: [f64; 9] = [
        f64::NAN,
        f64::INFINITY,
        -1.0,
        0.0,
        1e300,
        -1e300,
        1e-300,
        1e6,
        0.5,
    ];
    const INTEGERS: [i64; 6] = [0, 1, 2, 3, 1000, i64::MAX];
    match value {
        Value::Table(table) => {
            let key = random.below(table.len());
            if let Some((key, part)) = table.iter_mut().nth(key) {
                *place += &format!(".{key}");
                change(part, random, place);
            }
        }
        Value::Array(items) => {
            // Lists in lists of lists: the ends must be met often enough as well.
            match random.below(12) {
                0 => items.clear(),
                1 => items.truncate(items.len() / 2),
                2 => items.extend(items.clone()),
                3 => items.reverse(),
                _ => {
                    let index = random.below(items.len());
                    *place += &format!("[{index}]");
                    if let Some(item) = items.get_mut(index) {
                        return change(item, random, place);
                    }
                }
            }
            *place += &format!(" has {} items", items.len());
        }
        Value::Float(number) => {
            *number = FLOATS[random.below(FLOATS.len())];
            *place += &format!(" = {number:?}");
        }
        Value::Integer(number) => {
            *number = INTEGERS[random.below(INTEGERS.len())];
            *place += &format!(" = {number}");
        }
        Value::String(text) => {
            text.clear();
            *place += " is empty";
        }
        Value::Boolean(flag) => *flag = !*flag,
        Value::Datetime(_) => {}
    }
}
