//! The OpenAPI document: what the handlers say of themselves, and the refusals that follow from what they take.
//!
//! A handler documents its answers and what only it refuses. The rest is the same everywhere and follows from the
//! operation itself: whoever takes a body refuses bodies, whoever names a session may miss it, whoever queues a job
//! may find the queue full. It is added here, once.

use super::calibration_bodies::CalibrationKind;
use super::pairing::COOKIE;
use super::routes::pairs::FrameName;
use super::sequence_bodies::SequenceWish;
use super::{App, routes};
use utoipa::OpenApi;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::security::{ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{
    ContentBuilder, OpenApi as Document, Ref, Response, ResponseBuilder, SecurityRequirement,
};
use utoipa_axum::router::OpenApiRouter;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "unlit",
        description = "Takes the light out of photographed objects: pairs, calibration, processing. \
                       Errors are `application/problem+json` with a stable `code`. A method that a path does not \
                       take is answered with 405 and `Allow`, a path that is not there with 404.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    components(schemas(CalibrationKind, FrameName, SequenceWish)),
    tags(
        (name = "capture", description = "Devices, sessions, pairs"),
        (name = "processing", description = "Scene, calibration, model, jobs"),
        (name = "events", description = "What happens, as it happens"),
        (name = "access", description = "Being let in, where a token is in force"),
        (name = "studio", description = "The simulated studio (`unlit serve --studio`)"),
    )
)]
struct Own;

/// All routes, and what the handlers say of themselves.
pub(super) fn api() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Own::openapi()).merge(routes::all())
}

/// The whole document as pretty JSON with a newline at its end, as `docs/openapi.json` holds it.
pub(super) fn text(mut document: Document) -> Result<String, serde_json::Error> {
    add_refusals(&mut document);
    Ok(document.to_pretty_json()? + "\n")
}

/// A refusal that many operations share.
struct Refusal {
    status: &'static str,
    /// Name of the response among the document's components.
    name: &'static str,
    words: &'static str,
    applies: fn(&Taken) -> bool,
}

/// What an operation takes, as far as its refusals depend on it.
struct Taken {
    item: bool,
    session: bool,
    body: bool,
    /// Whether its method may bring a body, wanted or not.
    sends: bool,
    queues: bool,
}

const REFUSALS: [Refusal; 13] = [
    Refusal {
        status: "400",
        name: "BadRequest",
        words: "What was sent makes no sense: `path_invalid`, `query_invalid`, `body_invalid`, `value_invalid` or \
                another code that ends so; or a WebSocket is asked for.",
        applies: |_| true,
    },
    Refusal {
        status: "401",
        name: "Unauthorized",
        words: "A token is in force, and nothing says who asks.",
        applies: |_| true,
    },
    Refusal {
        status: "403",
        name: "Forbidden",
        words: "A page of another origin asked (`origin_refused`), or token or ticket are wrong.",
        applies: |_| true,
    },
    Refusal {
        status: "404",
        name: "NotFound",
        words: "It is not there: `session_not_found`, `pair_not_found`, `file_not_found` or `job_not_found`.",
        applies: |taken| taken.item,
    },
    Refusal {
        status: "409",
        name: "Conflict",
        words: "The session cannot be used as it is: `session_locked` (another program has it), `session_too_new`, \
                `disk_full`.",
        applies: |taken| taken.session,
    },
    Refusal {
        status: "408",
        name: "BodyTooSlow",
        words: "The body came too slowly: `body_too_slow`.",
        applies: |taken| taken.sends,
    },
    Refusal {
        status: "413",
        name: "BodyTooLarge",
        words: "More than 64 kB of JSON, or 1 GB of files: `body_too_large`.",
        applies: |taken| taken.sends,
    },
    Refusal {
        status: "415",
        name: "ContentTypeUnsupported",
        words: "The body's Content-Type is not the one that is documented: `content_type_unsupported`.",
        applies: |taken| taken.sends,
    },
    Refusal {
        status: "421",
        name: "Misdirected",
        words: "The request was meant for another host: `host_refused`.",
        applies: |_| true,
    },
    Refusal {
        status: "422",
        name: "Unprocessable",
        words: "The body is JSON, but not of the form that is taken (`body_invalid`), or an `Idempotency-Key` came \
                with another wish before (`idempotency_key_reused`).",
        applies: |taken| taken.body || taken.queues,
    },
    Refusal {
        status: "429",
        name: "QueueFull",
        words: "Too many jobs wait already: `queue_full`. `Retry-After` says when to ask again.",
        applies: |taken| taken.queues,
    },
    Refusal {
        status: "500",
        name: "Failed",
        words: "The program or its disk failed; the log says more.",
        applies: |_| true,
    },
    Refusal {
        status: "503",
        name: "Unavailable",
        words: "Too many connections at once (`too_many_connections`), or the program is about to end (`closing`).",
        applies: |_| true,
    },
];

fn add_refusals(document: &mut Document) {
    add_keys(document);
    let components = document.components.get_or_insert_default();
    for Refusal { name, words, .. } in &REFUSALS {
        components.responses.insert((*name).to_owned(), problem(words).into());
    }
    for (path, item) in &mut document.paths.paths {
        for (sends, operation) in operations(item) {
            let taken = taken(path, operation, sends);
            let answers = &mut operation.responses.responses;
            for refusal in REFUSALS.iter().filter(|refusal| (refusal.applies)(&taken)) {
                answers
                    .entry(refusal.status.into())
                    .or_insert_with(|| Ref::from_response_name(refusal.name).into());
            }
        }
    }
}

/// How to be let in. The first, empty way: without a token in force nothing has to be shown.
fn add_keys(document: &mut Document) {
    let keyed = |place: fn(ApiKeyValue) -> ApiKey, name: &str, words: &str| {
        SecurityScheme::ApiKey(place(ApiKeyValue::with_description(name, words)))
    };
    let bearer = HttpBuilder::new()
        .scheme(HttpAuthScheme::Bearer)
        .description(Some("The token of `--token-file`, for scripts"))
        .build();
    let components = document.components.get_or_insert_default();
    components.add_security_scheme("token", SecurityScheme::Http(bearer));
    components.add_security_scheme("cookie", keyed(ApiKey::Cookie, COOKIE, "What POST /api/v1/pairing sets"));
    components
        .add_security_scheme("ticket", keyed(ApiKey::Query, "ticket", "One GET, from POST /api/v1/tickets"));
    let none: [&str; 0] = [];
    let ways = ["token", "cookie", "ticket"].map(|name| SecurityRequirement::new(name, none));
    document.security = Some([SecurityRequirement::default()].into_iter().chain(ways).collect());
}

fn problem(words: &str) -> Response {
    let body = ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemBody"))).build();
    ResponseBuilder::new().description(words).content("application/problem+json", body).build()
}

/// The operations of a path, and whether their methods may bring a body.
fn operations(item: &mut PathItem) -> impl Iterator<Item = (bool, &mut Operation)> {
    let get = (false, &mut item.get);
    let sending =
        [&mut item.put, &mut item.post, &mut item.delete, &mut item.patch].map(|method| (true, method));
    [get].into_iter().chain(sending).filter_map(|(sends, operation)| Some((sends, operation.as_mut()?)))
}

fn taken(path: &str, operation: &Operation, sends: bool) -> Taken {
    Taken {
        item: path.contains('{'),
        session: path.contains("{session}"),
        body: operation.request_body.is_some(),
        sends,
        queues: operation.responses.responses.contains_key("202"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn every_operation_documents_its_refusals_as_problems() {
        let document: Value = serde_json::from_str(&text(api().into_openapi()).unwrap()).unwrap();
        let mut seen = 0;
        for (path, item) in document["paths"].as_object().unwrap() {
            for (method, operation) in item.as_object().unwrap() {
                seen += 1;
                let answers = operation["responses"].as_object().unwrap();
                for always in ["400", "401", "403", "421", "500", "503"] {
                    assert!(answers.contains_key(always), "{method} {path} lacks {always}");
                }
                for (status, answer) in answers.iter().filter(|(status, _)| *status >= &"400".to_owned()) {
                    let named = answer["$ref"].as_str().map(|name| name.rsplit('/').next().unwrap());
                    let answer = named.map_or(answer, |name| &document["components"]["responses"][name]);
                    let problem = &answer["content"]["application/problem+json"]["schema"]["$ref"];
                    assert_eq!(problem, "#/components/schemas/ProblemBody", "{method} {path} {status}");
                }
                if operation["requestBody"]["required"] == true {
                    assert!(answers.contains_key("415"), "{method} {path}");
                }
                let queues = answers.contains_key("202");
                assert!(!queues || answers.contains_key("429"), "{method} {path}");
            }
        }
        assert!(seen > 25, "{seen} operations");
    }

    /// Adds whatever `value` refers to.
    fn references<'a>(value: &'a Value, into: &mut Vec<&'a str>) {
        match value {
            Value::Object(entries) => {
                into.extend(entries.get("$ref").and_then(Value::as_str));
                entries.values().for_each(|entry| references(entry, into));
            }
            Value::Array(entries) => entries.iter().for_each(|entry| references(entry, into)),
            _ => {}
        }
    }

    #[test]
    fn whatever_the_document_refers_to_is_in_it() {
        let document: Value = serde_json::from_str(&text(api().into_openapi()).unwrap()).unwrap();
        let mut named = Vec::new();
        references(&document, &mut named);
        assert!(named.len() > 50, "{} references", named.len());
        for name in named {
            assert!(document.pointer(name.trim_start_matches('#')).is_some(), "{name} is not there");
        }
    }
}
