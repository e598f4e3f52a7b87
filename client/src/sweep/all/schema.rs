//! `schema.json` holds what a sweep's documents look like, as JSON Schema (draft 2020-12); this checks against it.
//!
//! Of the language it knows what that file uses, and refuses a schema that uses more: `$ref` into `$defs`, `type`,
//! `const`, `enum`, `required`, `properties`, `additionalProperties`, `items`, `minItems`, `maxItems`, `minimum`.

use serde_json::{Map, Value};

/// The schema's text.
const TEXT: &str = include_str!("schema.json");

/// What of a document is not as `#/$defs/<definition>` says, a line each, with the place.
pub(in crate::sweep) fn violations(document: &Value, definition: &str) -> Vec<String> {
    let root: Value = serde_json::from_str(TEXT).unwrap();
    let mut found = Vec::new();
    check(&root, &root["$defs"][definition], document, definition, &mut found);
    found
}

fn check(root: &Value, schema: &Value, value: &Value, place: &str, found: &mut Vec<String>) {
    if let Value::Bool(allowed) = schema {
        if !allowed {
            found.push(format!("{place}: not expected"));
        }
        return;
    }
    let Value::Object(rules) = schema else { panic!("{place}: expected a schema, found {schema}") };
    let mut expected = |holds: bool, what: &str| {
        if !holds {
            found.push(format!("{place}: expected {what}, found {value}"));
        }
    };
    for (rule, argument) in rules {
        let size = argument.as_u64().unwrap_or(0) as usize;
        match rule.as_str() {
            "description" | "$ref" | "required" | "properties" | "additionalProperties" | "items" => {}
            "type" => {
                let names = argument.as_array().cloned().unwrap_or_else(|| vec![argument.clone()]);
                expected(names.iter().any(|name| is_of(value, name.as_str().unwrap())), &argument.to_string());
            }
            "const" => expected(value == argument, &argument.to_string()),
            "enum" => expected(argument.as_array().unwrap().contains(value), &argument.to_string()),
            "minimum" => expected(value.as_f64().is_none_or(|v| v >= argument.as_f64().unwrap()), ">= the minimum"),
            "minItems" => expected(value.as_array().is_none_or(|items| items.len() >= size), "more items"),
            "maxItems" => expected(value.as_array().is_none_or(|items| items.len() <= size), "fewer items"),
            unknown => panic!("{place}: the schema uses {unknown}"),
        }
    }
    if let Some(reference) = rules.get("$ref").and_then(Value::as_str) {
        let definition = root.pointer(reference.trim_start_matches('#')).unwrap_or_else(|| panic!("{reference}"));
        check(root, definition, value, place, found);
    }
    match value {
        Value::Object(fields) => check_fields(root, rules, fields, place, found),
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                if let Some(schema) = rules.get("items") {
                    check(root, schema, item, &format!("{place}/{index}"), found);
                }
            }
        }
        _ => {}
    }
}

fn check_fields(
    root: &Value,
    rules: &Map<String, Value>,
    fields: &Map<String, Value>,
    place: &str,
    found: &mut Vec<String>,
) {
    for name in rules.get("required").and_then(Value::as_array).into_iter().flatten() {
        if !fields.contains_key(name.as_str().unwrap()) {
            found.push(format!("{place}: {name} is missing"));
        }
    }
    for (name, field) in fields {
        let own = rules.get("properties").and_then(|properties| properties.get(name));
        if let Some(schema) = own.or(rules.get("additionalProperties")) {
            check(root, schema, field, &format!("{place}/{name}"), found);
        }
    }
}

fn is_of(value: &Value, name: &str) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        unknown => panic!("the schema names the type {unknown}"),
    }
}
