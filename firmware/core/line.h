/* Lines of the protocol: checksum, strict parsing of requests, writing of replies and events.
 * Pure functions on buffers that the caller owns; ../PROTOCOL.md is the spec. */
#ifndef UNLIT_LINE_H
#define UNLIT_LINE_H

#include <stdbool.h>
#include <stdint.h>

/* Constant text. On the AVR it stays in the program's memory: constants would fill a fifth of its RAM. */
#ifdef __AVR__
#define LINE_ROM const __flash
#define TEXT(text) (__extension__({ static LINE_ROM char rom[] = text; &rom[0]; }))
#else
#define LINE_ROM const
#define TEXT(text) (text)
#endif

enum { LINE_REQUEST_MAX = 96, LINE_TEXT_MAX = 140, LINE_ARGS_MAX = 6 };

/* Why a request is refused; the numbers go over the wire. */
enum line_error {
    LINE_OK = 0,
    LINE_CRC = 1,
    LINE_SYNTAX = 2,
    LINE_LONG = 3,
    LINE_VERB = 4,
    LINE_ARG = 5,
    LINE_SEQ = 6,
    LINE_HELLO = 7,
    LINE_NOTREADY = 10,
    LINE_BUSY = 11,
    LINE_RATE = 12,
    LINE_GONE = 13
};

struct line_arg {
    const char *key;
    uint32_t value;
    bool taken; /* the verb has read it; one left untaken is an unknown key */
};

struct line_request {
    const char *verb;
    struct line_arg args[LINE_ARGS_MAX];
    uint8_t count;
    uint8_t seq; /* 0: un-numbered, typed by a person */
    uint16_t crc;
};

/* CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; "123456789" gives 0x29B1. */
uint16_t line_crc(const char *text, uint8_t length);

/* Parses text in place (it gets NULs); text has room for one byte more than length. On an error out->seq is
 * the request's number only if its CRC was right, else 0: a number out of a damaged line means nothing. */
enum line_error line_parse(char *text, uint8_t length, struct line_request *out);

bool line_is(const char *word, LINE_ROM char *name);

/* Fetches the argument key and marks it taken. False if it is not there. */
bool line_take(struct line_request *request, LINE_ROM char *key, uint32_t *value);

/* True once every argument has been taken. */
bool line_all_taken(const struct line_request *request);

/* A line under construction; what does not fit is cut, and the longest line is proven to fit by test. */
struct line_writer {
    char text[LINE_TEXT_MAX];
    uint8_t length;
};

void line_start(struct line_writer *line);
void line_text(struct line_writer *line, LINE_ROM char *text);
void line_uint(struct line_writer *line, uint32_t value);
/* Appends " key=value". */
void line_pair(struct line_writer *line, LINE_ROM char *key, uint32_t value);
void line_signed(struct line_writer *line, LINE_ROM char *key, int32_t value);
void line_word(struct line_writer *line, LINE_ROM char *key, LINE_ROM char *value);
/* Appends "*HEX4", the checksum of all before it, and the line end. */
void line_seal(struct line_writer *line);

#endif
