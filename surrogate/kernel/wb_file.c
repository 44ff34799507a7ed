/* Map a packed table and check it: surrogate/kernel/format.py writes the file. MIT license.
 *
 * The checksum is computed from blocks that are read, not from the mapped pages: what is mapped
 * becomes resident only where answers read it.
 */
#define _POSIX_C_SOURCE 200809L /* fileno, fstat, mmap */

#include "wb_file.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#else
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#endif

enum { BLOCK = 1 << 18, SLICES = 16 };

static const unsigned char MAGIC[8] = {0x89, 'W', 'B', 'T', '\r', '\n', 0x1a, '\n'};

/* CRC-32 of zlib (polynomial 0xEDB88320), sixteen bytes a step (Kounavis and Berry 2008). */
static void crc_tables(uint32_t table[SLICES][256]) {
    for (uint32_t n = 0; n < 256; n++) {
        uint32_t c = n;
        for (int k = 0; k < 8; k++) c = c & 1 ? 0xEDB88320u ^ (c >> 1) : c >> 1;
        table[0][n] = c;
    }
    for (int slice = 1; slice < SLICES; slice++)
        for (uint32_t n = 0; n < 256; n++) {
            uint32_t c = table[slice - 1][n];
            table[slice][n] = table[0][c & 255] ^ (c >> 8);
        }
}

static uint32_t crc_of(uint32_t table[SLICES][256], uint32_t crc, const unsigned char *bytes,
                       size_t count) {
    crc = ~crc;
    for (; count >= SLICES; bytes += SLICES, count -= SLICES) {
        uint32_t word[4], next = 0;
        memcpy(word, bytes, sizeof word);
        word[0] ^= crc; /* little-endian: WB_HEADER's byte order has been checked */
        for (int k = 0; k < 4; k++)
            next ^= table[15 - 4 * k][word[k] & 255] ^ table[14 - 4 * k][word[k] >> 8 & 255]
                    ^ table[13 - 4 * k][word[k] >> 16 & 255] ^ table[12 - 4 * k][word[k] >> 24];
        crc = next;
    }
    for (; count; bytes++, count--) crc = table[0][(crc ^ *bytes) & 255] ^ (crc >> 8);
    return ~crc;
}

/* Refuse what is not a whole table of this format. */
static int check_header(const wb_header *head, uint64_t size, char *why, size_t room) {
    if (memcmp(head->magic, MAGIC, 8))
        return snprintf(why, room, "this is not a packed table of wrenchbook"), 0;
    if (head->byte_order != 0x01020304u)
        return snprintf(why, room, "the table has another byte order or is damaged"), 0;
    if (head->format != WB_FORMAT)
        return snprintf(why, room, "the table has format %u, this program reads format %u: %s",
                        (unsigned)head->format, (unsigned)WB_FORMAT,
                        head->format > WB_FORMAT ? "use a newer wrenchbook" : "download it again"), 0;
    if (head->size != size)
        return snprintf(why, room, "the table is damaged: %llu of its %llu bytes",
                        (unsigned long long)size, (unsigned long long)head->size), 0;
    return 1;
}

/* The checksum of a header, all bytes but the checksum itself. */
static uint32_t crc_of_header(uint32_t table[SLICES][256], const wb_header *head) {
    const unsigned char *bytes = (const unsigned char *)head;
    size_t before = offsetof(wb_header, checksum), after = before + sizeof head->checksum;
    return crc_of(table, crc_of(table, 0, bytes, before), bytes + after, sizeof *head - after);
}

static int check_sum(uint64_t sum, const wb_header *head, char *why, size_t room) {
    if (sum == head->checksum) return 1;
    return snprintf(why, room, "the table is damaged: its checksum is wrong"), 0;
}

int wb_check_bytes(const unsigned char *bytes, size_t count, char *why, size_t room) {
    uint32_t table[SLICES][256];
    wb_header head;
    if (count < sizeof head)
        return snprintf(why, room, "this is not a packed table: %llu bytes",
                        (unsigned long long)count), 0;
    memcpy(&head, bytes, sizeof head);
    if (!check_header(&head, count, why, room)) return 0;
    crc_tables(table);
    uint32_t sum = crc_of_header(table, &head);
    sum = crc_of(table, sum, bytes + sizeof head, count - sizeof head);
    return check_sum(sum, &head, why, room);
}

static int check_file(FILE *file, uint64_t size, char *why, size_t room) {
    uint32_t table[SLICES][256], sum = 0;
    wb_header head;
    size_t got;
    if (fread(&head, 1, sizeof head, file) != sizeof head)
        return snprintf(why, room, "this is not a packed table: %llu bytes",
                        (unsigned long long)size), 0;
    if (!check_header(&head, size, why, room)) return 0;
    unsigned char *block = malloc(BLOCK);
    if (!block) return snprintf(why, room, "no memory"), 0;
    crc_tables(table);
    sum = crc_of_header(table, &head);
    while ((got = fread(block, 1, BLOCK, file)) > 0) sum = crc_of(table, sum, block, got);
    free(block);
    return check_sum(sum, &head, why, room);
}

#ifdef _WIN32

static wchar_t *wide_path(const char *path) {
    int count = MultiByteToWideChar(CP_UTF8, 0, path, -1, NULL, 0);
    wchar_t *wide = count > 0 ? malloc((size_t)count * sizeof *wide) : NULL;
    if (wide) MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, count);
    return wide;
}

static FILE *open_file(const char *path, uint64_t *size) {
    wchar_t *wide = wide_path(path);
    FILE *file = wide ? _wfopen(wide, L"rb") : NULL;
    free(wide);
    if (file && (_fseeki64(file, 0, SEEK_END) || (*size = (uint64_t)_ftelli64(file), 0)))
        return fclose(file), NULL;
    if (file) rewind(file);
    return file;
}

static const void *map_file(const char *path, uint64_t size) {
    const void *bytes = NULL;
    wchar_t *wide = wide_path(path);
    HANDLE map = NULL, file = wide ? CreateFileW(wide, GENERIC_READ,
        FILE_SHARE_READ | FILE_SHARE_DELETE, NULL, OPEN_EXISTING, FILE_ATTRIBUTE_NORMAL, NULL)
        : INVALID_HANDLE_VALUE;
    free(wide);
    if (file == INVALID_HANDLE_VALUE) return NULL;
    map = CreateFileMappingW(file, NULL, PAGE_READONLY, 0, 0, NULL);
    if (map) bytes = MapViewOfFile(map, FILE_MAP_READ, 0, 0, (SIZE_T)size);
    if (map) CloseHandle(map);
    CloseHandle(file);
    return bytes;
}

static void unmap(const void *bytes, size_t size) {
    (void)size;
    UnmapViewOfFile(bytes);
}

#else

static FILE *open_file(const char *path, uint64_t *size) {
    FILE *file = fopen(path, "rb");
    struct stat about;
    if (file && fstat(fileno(file), &about)) return fclose(file), NULL;
    if (file) *size = (uint64_t)about.st_size;
    return file;
}

static const void *map_file(const char *path, uint64_t size) {
    int file = open(path, O_RDONLY);
    if (file < 0) return NULL;
    void *bytes = mmap(NULL, (size_t)size, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    return bytes == MAP_FAILED ? NULL : bytes;
}

static void unmap(const void *bytes, size_t size) { munmap((void *)bytes, size); }

#endif

const unsigned char *wb_map(const char *path, size_t *count, char *why, size_t room) {
    uint64_t size = 0;
    FILE *file = open_file(path, &size);
    if (!file) return snprintf(why, room, "cannot open the table %s", path), NULL;
    setvbuf(file, NULL, _IONBF, 0); /* the blocks are large: no second copy */
    int sound = check_file(file, size, why, room);
    fclose(file);
    if (!sound) return NULL;
    const unsigned char *bytes = map_file(path, size);
    if (!bytes) return snprintf(why, room, "cannot map the table %s", path), NULL;
    *count = (size_t)size;
    return bytes;
}

void wb_unmap(wb_table *t) {
    if (t->mapped) unmap(t->bytes, t->mapped);
}
