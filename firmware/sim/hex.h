/* Intel hex files. */
#ifndef UNLIT_SIM_HEX_H
#define UNLIT_SIM_HEX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Lays the file's bytes into memory, and tells the lowest address if asked. False, with the reason on stderr, if it is not there, damaged or too large.
 * simavr's own reader gives up at a start address, which boot loaders have. */
bool hex_load(const char *path, uint8_t *memory, size_t size, size_t *lowest);

#endif
