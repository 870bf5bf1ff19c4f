#include "gh_frame.h"

#include <string.h>

uint16_t gh_crc16(const uint8_t *data, size_t length)
{
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)data[i] << 8));
        for (int bit = 0; bit < 8; bit++) {
            uint16_t shifted = (uint16_t)(crc << 1);
            crc = (crc & 0x8000u) != 0u ? (uint16_t)(shifted ^ 0x1021u) : shifted;
        }
    }
    return crc;
}

/* One block only: the longest frame is shorter than COBS' 254 bytes. */
static size_t cobs_encode(const uint8_t *data, size_t length, uint8_t *out)
{
    size_t code = 0; /* where the distance to the next zero is written */
    for (size_t i = 0; i < length; i++) {
        if (data[i] == 0) {
            out[code] = (uint8_t)(i + 1 - code);
            code = i + 1;
        } else {
            out[i + 1] = data[i];
        }
    }
    out[code] = (uint8_t)(length + 1 - code);
    return length + 1;
}

/* Decodes in place: every code byte but the first stands for a zero. False when it ends inside a block. */
static bool cobs_decode(uint8_t *bytes, size_t *length)
{
    size_t code = 0;
    while (code < *length) {
        size_t next = code + bytes[code];
        bytes[code] = 0;
        code = next;
    }
    if (code != *length) {
        return false;
    }
    *length -= 1;
    memmove(bytes, bytes + 1, *length);
    return true;
}

size_t gh_frame_encode(const uint8_t *payload, size_t length, uint8_t *out)
{
    uint8_t plain[GH_MAX_DECODED];
    if (length > GH_MAX_PAYLOAD) {
        return 0;
    }
    memcpy(plain, payload, length);
    uint16_t crc = gh_crc16(payload, length);
    plain[length] = (uint8_t)(crc >> 8);
    plain[length + 1] = (uint8_t)(crc & 0xFFu);
    size_t written = cobs_encode(plain, length + GH_CRC_LENGTH, out);
    out[written] = 0;
    return written + 1;
}

void gh_frame_decoder_init(gh_frame_decoder *decoder)
{
    memset(decoder, 0, sizeof *decoder);
}

/* The payload's length when the collected line is a good frame, else 0. */
static size_t decode_line(gh_frame_decoder *decoder)
{
    size_t length = decoder->length;
    if (!cobs_decode(decoder->bytes, &length)) {
        decoder->bad_cobs++;
    } else if (length < GH_HEADER_LENGTH + GH_CRC_LENGTH) {
        decoder->too_short++;
    } else if (gh_crc16(decoder->bytes, length) != 0) { /* the CRC over data and its own CRC is 0 */
        decoder->bad_crc++;
    } else {
        return length - GH_CRC_LENGTH;
    }
    return 0;
}

size_t gh_frame_push(gh_frame_decoder *decoder, uint8_t byte)
{
    size_t payload = 0;
    if (byte == 0) {
        if (!decoder->overlong && decoder->length > 0) {
            payload = decode_line(decoder);
        }
        decoder->length = 0;
        decoder->overlong = false;
    } else if (decoder->overlong) {
        return 0;
    } else if (decoder->length == GH_MAX_LINE) {
        decoder->overlong = true;
        decoder->too_long++;
    } else {
        decoder->bytes[decoder->length++] = byte;
    }
    return payload;
}
