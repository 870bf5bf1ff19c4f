/* Frames on the line: COBS( payload | CRC-16 ) 0x00. See PROTOCOL.md, "Frame". */
#ifndef GH_FRAME_H
#define GH_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "gh_messages.h"

#define GH_MAX_PAYLOAD ((size_t)GH_HEADER_LENGTH + GH_MAX_BODY)
#define GH_CRC_LENGTH 2
#define GH_MAX_DECODED (GH_MAX_PAYLOAD + GH_CRC_LENGTH)
#define GH_MAX_LINE (GH_MAX_DECODED + 1) /* COBS adds one byte to less than 255; without the 0x00 */
#define GH_MAX_FRAME (GH_MAX_LINE + 1)   /* with the 0x00 */

/* CRC-16/IBM-3740: polynomial 0x1021, initial 0xFFFF, check value 0x29B1. */
uint16_t gh_crc16(const uint8_t *data, size_t length);

/* Writes the frame of `payload`, its 0x00 included, to `out` (GH_MAX_FRAME bytes). Returns its length;
 * 0 when the payload is longer than GH_MAX_PAYLOAD. */
size_t gh_frame_encode(const uint8_t *payload, size_t length, uint8_t *out);

typedef struct {
    uint8_t bytes[GH_MAX_LINE];
    uint8_t length;
    bool overlong; /* drop everything up to the next 0x00 */
    uint16_t too_long, bad_cobs, too_short, bad_crc;
} gh_frame_decoder;

void gh_frame_decoder_init(gh_frame_decoder *decoder);

/* Takes one byte from the line. Returns the length of the payload that it completed, which then stands in
 * decoder->bytes until the next call; 0 when there is none. Nonsense is dropped and counted. */
size_t gh_frame_push(gh_frame_decoder *decoder, uint8_t byte);

#endif
