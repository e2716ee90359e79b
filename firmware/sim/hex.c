#include "hex.h"

#include <stdio.h>
#include <string.h>

enum { DATA = 0, END = 1, SEGMENT = 2, LINEAR = 4 };

/* Reads ":LLAAAATT..CC" into bytes; their number, or 0 if the line is none or its sum is wrong. */
static size_t read_record(const char *line, uint8_t *bytes, size_t room)
{
    size_t count = 0;
    uint8_t sum = 0;
    unsigned byte = 0;
    if (*line++ != ':') {
        return 0;
    }
    while (count < room && sscanf(line, "%2x", &byte) == 1) {
        bytes[count++] = (uint8_t)byte;
        sum = (uint8_t)(sum + byte);
        line += 2;
    }
    return count >= 5 && sum == 0 && count == (size_t)bytes[0] + 5 ? count : 0;
}

bool hex_load(const char *path, uint8_t *memory, size_t size, size_t *lowest)
{
    FILE *file = fopen(path, "r");
    if (file == NULL) {
        perror(path);
        return false;
    }
    char line[600];
    size_t base = 0, first = size;
    bool ended = false, good = true;
    while (good && !ended && fgets(line, sizeof line, file) != NULL) {
        uint8_t record[300];
        const size_t count = read_record(line, record, sizeof record);
        const size_t at = base + (size_t)(record[1] << 8 | record[2]);
        good = count != 0 && (record[3] != DATA || at + record[0] <= size);
        if (good && record[3] == DATA) {
            memcpy(memory + at, record + 4, record[0]);
            first = at < first ? at : first;
        } else if (good && (record[3] == SEGMENT || record[3] == LINEAR)) {
            base = (size_t)(record[4] << 8 | record[5]) << (record[3] == SEGMENT ? 4 : 16);
        }
        ended = good && record[3] == END;
    }
    fclose(file);
    if (lowest != NULL) {
        *lowest = first;
    }
    if (!ended) {
        fprintf(stderr, "%s: no whole Intel hex file of at most %zu bytes\n", path, size);
    }
    return ended;
}
