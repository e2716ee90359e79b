//! The HTTP face: routes, events, page, OpenAPI. No logic.
