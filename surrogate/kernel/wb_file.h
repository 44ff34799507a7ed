/* The form of a packed table on disk. MIT license. */
#ifndef WB_FILE_H
#define WB_FILE_H

#include "wb_internal.h"

#define WB_FORMAT 7u /* other formats are refused */
enum { WB_NAME = 64 };

typedef struct {
    unsigned char magic[8];
    uint32_t format, byte_order;
    uint64_t checksum; /* CRC-32 of all other bytes of the file */
    uint64_t size, directory, arrays, json, json_size;
} wb_header;

typedef struct {
    char name[WB_NAME];
    uint32_t type, dimensions;
    uint64_t shape[4], offset, bytes, unused;
} wb_entry;

/* Check bytes, or check and map a file. On failure return 0 or NULL and write a reason into `why`. */
int wb_check_bytes(const unsigned char *bytes, size_t count, char *why, size_t room);
const unsigned char *wb_map(const char *path, size_t *count, char *why, size_t room);

#endif
