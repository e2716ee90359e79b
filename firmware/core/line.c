#include "line.h"

#include <string.h>

static LINE_ROM char hex_digits[] = "0123456789ABCDEF";

uint16_t line_crc(const char *text, uint8_t length)
{
    uint16_t crc = 0xFFFFu;
    for (uint8_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)(uint8_t)text[i] << 8));
        for (uint8_t bit = 0; bit < 8; bit++) {
            const bool carry = (crc & 0x8000u) != 0;
            crc = (uint16_t)(crc << 1);
            if (carry) {
                crc = (uint16_t)(crc ^ 0x1021u);
            }
        }
    }
    return crc;
}

static bool is_lower(char c)
{
    return c >= 'a' && c <= 'z';
}

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* Reads decimal digits at *at. False without a digit or beyond 32 bits; *at stands behind the digits either way. */
static bool read_uint(const char **at, uint32_t *value)
{
    bool fits = is_digit(**at);
    uint32_t sum = 0;
    for (; is_digit(**at); (*at)++) {
        const uint32_t digit = (uint32_t)(**at - '0');
        if (sum > (UINT32_MAX - digit) / 10u) {
            fits = false;
        } else {
            sum = sum * 10u + digit;
        }
    }
    *value = sum;
    return fits;
}

static const char *skip_name(const char *at)
{
    while (is_lower(*at)) {
        at++;
    }
    return at;
}

/* Splits " key=uint" groups from at on, which ends in NUL. */
static enum line_error parse_args(char *at, struct line_request *out)
{
    while (*at != '\0') {
        *at++ = '\0'; /* the space that ended the word before */
        const char *key = at;
        const char *end = skip_name(key);
        if (end == key || *end != '=') {
            return LINE_SYNTAX;
        }
        at += end - key;
        *at++ = '\0';
        const char *digits = at;
        uint32_t value = 0;
        const bool fits = read_uint(&digits, &value);
        if (digits == at || (*digits != '\0' && *digits != ' ')) {
            return LINE_SYNTAX;
        }
        if (!fits || out->count == LINE_ARGS_MAX) {
            return LINE_ARG;
        }
        for (uint8_t i = 0; i < out->count; i++) {
            if (strcmp(out->args[i].key, key) == 0) {
                return LINE_ARG;
            }
        }
        out->args[out->count].key = key;
        out->args[out->count].value = value;
        out->args[out->count].taken = false;
        out->count++;
        at += digits - at;
    }
    return LINE_OK;
}

/* Checks and cuts off "*HEX4". *had tells whether there was one. */
static enum line_error take_crc(char *text, uint8_t *length, uint16_t *crc, bool *had)
{
    const char *star = memchr(text, '*', *length);
    *had = star != NULL;
    *crc = 0;
    if (star == NULL) {
        return LINE_OK;
    }
    const uint8_t covered = (uint8_t)(star - text);
    if (*length - covered != 5) {
        return LINE_CRC;
    }
    for (uint8_t i = 0; i < 4; i++) {
        uint8_t digit = 0;
        while (digit < 16 && hex_digits[digit] != star[1 + i]) {
            digit++;
        }
        if (digit == 16) {
            return LINE_CRC;
        }
        *crc = (uint16_t)((*crc << 4) | digit);
    }
    if (*crc != line_crc(text, covered)) {
        return LINE_CRC;
    }
    text[covered] = '\0';
    *length = covered;
    return LINE_OK;
}

enum line_error line_parse(char *text, uint8_t length, struct line_request *out)
{
    memset(out, 0, sizeof *out);
    text[length] = '\0';
    bool checked = false;
    const enum line_error crc_error = take_crc(text, &length, &out->crc, &checked);
    if (crc_error != LINE_OK) {
        return crc_error;
    }
    if (memchr(text, '\0', length) != NULL) {
        return LINE_SYNTAX;
    }
    char *at = text;
    if (*at == '#') {
        if (!checked) {
            return LINE_CRC;
        }
        const char *digits = at + 1;
        uint32_t seq = 0;
        if (!read_uint(&digits, &seq) || *digits != ' ' || seq == 0 || seq > 255) {
            return LINE_SYNTAX;
        }
        out->seq = (uint8_t)seq;
        at += digits - at + 1;
    }
    out->verb = at;
    const char *end = skip_name(at);
    if (end == at || (*end != '\0' && *end != ' ')) {
        return LINE_SYNTAX;
    }
    return parse_args(at + (end - at), out);
}

bool line_is(const char *word, LINE_ROM char *name)
{
    while (*word != '\0' && *word == *name) {
        word++;
        name++;
    }
    return *word == *name;
}

bool line_take(struct line_request *request, LINE_ROM char *key, uint32_t *value)
{
    for (uint8_t i = 0; i < request->count; i++) {
        if (line_is(request->args[i].key, key)) {
            request->args[i].taken = true;
            *value = request->args[i].value;
            return true;
        }
    }
    return false;
}

bool line_all_taken(const struct line_request *request)
{
    for (uint8_t i = 0; i < request->count; i++) {
        if (!request->args[i].taken) {
            return false;
        }
    }
    return true;
}

void line_start(struct line_writer *line)
{
    line->length = 0;
}

static void put(struct line_writer *line, char c)
{
    if (line->length < LINE_TEXT_MAX) {
        line->text[line->length++] = c;
    }
}

void line_text(struct line_writer *line, LINE_ROM char *text)
{
    while (*text != '\0') {
        put(line, *text++);
    }
}

void line_uint(struct line_writer *line, uint32_t value)
{
    char digits[10];
    uint8_t count = 0;
    do {
        digits[count++] = (char)('0' + (char)(value % 10u));
        value /= 10u;
    } while (value != 0);
    while (count > 0) {
        put(line, digits[--count]);
    }
}

static void key_sign(struct line_writer *line, LINE_ROM char *key)
{
    put(line, ' ');
    line_text(line, key);
    put(line, '=');
}

void line_pair(struct line_writer *line, LINE_ROM char *key, uint32_t value)
{
    key_sign(line, key);
    line_uint(line, value);
}

void line_signed(struct line_writer *line, LINE_ROM char *key, int32_t value)
{
    key_sign(line, key);
    if (value < 0) {
        put(line, '-');
    }
    line_uint(line, value < 0 ? 0u - (uint32_t)value : (uint32_t)value);
}

void line_word(struct line_writer *line, LINE_ROM char *key, LINE_ROM char *value)
{
    key_sign(line, key);
    line_text(line, value);
}

void line_seal(struct line_writer *line)
{
    const uint16_t crc = line_crc(line->text, line->length);
    put(line, '*');
    for (uint8_t shift = 16; shift > 0; shift = (uint8_t)(shift - 4)) {
        put(line, hex_digits[(crc >> (shift - 4)) & 0xFu]);
    }
    put(line, '\n');
}
